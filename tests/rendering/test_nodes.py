import numpy as np
import pytest

from periscopy_sim.rendering.nodes import SceneNodes, searching, texture_of
from periscopy_sim.rendering.variant import mi
from periscopy_sim.rendering.wall import camera_of
from periscopy_sim.scene import EmissionProfile


@pytest.mark.parametrize(
    ("emitter", "profile"),
    [
        ('<emitter type="lcd"><rgb name="radiance" value="1"/></emitter>', EmissionProfile(0, 0)),
        ('<emitter type="directionalarea"><rgb name="radiance" value="1"/></emitter>', None),
        ('<emitter type="area"><rgb name="radiance" value="1"/></emitter>', EmissionProfile(0, 0)),
    ],
)
def test_profile_is_known_of_area_and_lcd_emitters_alone(room, emitter, profile):
    nodes = SceneNodes(room.write(monitor=room.monitor(emitter)))
    assert nodes.emission_profile("monitor") == profile


def seen_on_monitor(scene, uv_from_viewer):
    """Radiance towards the wall at places of the screen: (across, down) in [0, 1] for a viewer."""
    radiance = []
    for across, down in uv_from_viewer:
        # The screen spans x = 0.4 (a viewer's left) to 0, z = 0.45 to 0.15, at y = 0.
        ray = mi.Ray3f([0.4 - 0.4 * across, 0.5, 0.45 - 0.3 * down], [0, -1, 0])
        si = scene.ray_intersect(ray)
        radiance.append(np.ravel(si.shape.emitter().eval(si)))
    return np.array(radiance)


def middles(rows, columns):
    return [((c + 0.5) / columns, (r + 0.5) / rows) for r in range(rows) for c in range(columns)]


@pytest.mark.parametrize(
    ("flip", "width", "hidden"),
    [(False, 0.2, (3, 4)), (True, 0.2, (1, 3)), (False, -0.2, (3, 1)), (True, -0.2, (3, 4))],
)
def test_image_appears_upright_and_unmirrored_on_any_rectangle(room, flip, width, hidden):
    image = np.random.default_rng(0).random((*hidden, 3)).astype(np.float32)
    texture = texture_of(image, mirrored=False)
    assert texture.shape[:2] == tuple(max(size, 2) for size in hidden)
    assert texture.flags.c_contiguous and min(texture.strides) > 0
    monitor = room.monitor(scale=(width, 0.15), turn=0 if flip else 180, flip=flip)
    nodes = SceneNodes(room.write(monitor=monitor))
    nodes.show({"monitor": texture})
    seen = seen_on_monitor(nodes.instantiate(), middles(*hidden))
    np.testing.assert_allclose(seen, image.reshape(-1, 3), rtol=1e-5)


def render(nodes, film_size=None):
    nodes.average_pixels(film_size)
    scene = nodes.instantiate()
    direct = mi.load_dict({"type": "direct"})
    return np.array(mi.render(scene, sensor=camera_of(scene), integrator=direct, spp=4, seed=1))


def test_pixels_are_averaged_whatever_film_filter_and_sampler_the_file_asks_for(room):
    odd = (
        '<rfilter type="gaussian"><float name="stddev" value="0.8"/></rfilter>'
        '<string name="pixel_format" value="luminance"/>'
        '<string name="component_format" value="float16"/>'
    )
    sampler = '<sampler type="independent"><integer name="sample_count" value="7"/></sampler>'
    asked = room.camera(inside_film=odd).replace("</sensor>", f"{sampler}</sensor>")
    pictures = []
    for camera in (room.camera(), asked):
        pictures.append(
            render(SceneNodes(room.write(monitor=room.monitor(room.area), camera=camera)))
        )
    assert pictures[0].shape == (5, 6, 3)
    assert pictures[0].dtype == np.float32
    np.testing.assert_array_equal(pictures[0], pictures[1])


def mesh(filename):
    return f'<shape type="ply" id="sofa"><string name="filename" value="{filename}"/></shape>'


def triangle(path, x):
    path.parent.mkdir(exist_ok=True)
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        f"{x} 0.5 0.2\n0.5 0.5 0.2\n0.4 0.5 0.3\n3 0 1 2\n"
    )


@pytest.mark.parametrize(
    "tag",
    [
        '<include filename="work.xml"/>',
        '<path value="folder"/>',
        '<bsdf type="diffuse"><spectrum name="reflectance" filename="paint.spd"/></bsdf>',
        mesh("sofa.ply"),
    ],
)
def test_no_file_is_taken_from_the_folder_that_the_process_started_in(
    room, tmp_path, monkeypatch, tag, refusal
):
    work = tmp_path / "work"
    (work / "folder").mkdir(parents=True)
    (work / "work.xml").write_text(f'<scene version="3.0.0">{room.blocker()}</scene>')
    (work / "paint.spd").write_text("300 0.25\n900 0.25\n")
    triangle(work / "sofa.ply", 0.4)
    monkeypatch.chdir(work)
    path = room.write(tag)
    assert len(mi.load_file(str(path)).shapes()) >= 2
    assert "names a missing file" in refusal(path)


def test_mitsuba_searches_the_folders_named_and_no_other(tmp_path):
    before = mi.file_resolver()
    with searching(tmp_path):
        assert [str(folder) for folder in mi.file_resolver()] == [str(tmp_path), *mi.__path__]
    assert list(mi.file_resolver()) == list(before)
