"""Scenes of whole laboratories: one comes of it, or one line says why none does."""

import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.laboratory.document import EXAMPLE
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from periscopy_sim.shipped import find_scene
from tests.laboratory.built.conftest import CAMERA, MONITOR, PERSPECTIVE, WALL, occluders


def test_example_builds_a_scene(built):
    scenario = built(EXAMPLE.read_text())
    assert [occluder.name for occluder in scenario.occluders] == [
        "foot", "stem", "shade", "picture_left", "picture_right", "picture_bottom", "picture_top",
    ]  # fmt: skip
    A = render_transport(scenario, samples=4)
    assert A.shape == (112 * 144, 6) and A.min() == 0 < A.max()  # something throws a shadow


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ((WALL, CAMERA, MONITOR.replace("}", ", turn: 180 deg}")), "the monitor faces away"),
        (
            (
                WALL,
                PERSPECTIVE % "target: [60 cm, 25 cm]",
                MONITOR,
                occluders("box", "width: 2 m, depth: 1 cm, height: 1 m"),
            ),
            "192 of 192 camera pixels miss the wall",
        ),
    ],
)
def test_laboratory_of_which_no_photograph_can_be_taken_is_refused(built, tmp_path, changed, said):
    with pytest.raises(SceneError, match=f"scene '{tmp_path}/lab.xml': .*{said}") as caught:
        built(*changed)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["lab.yaml"]


CHAIR = [
    ("seat", (506, 594, 238), (75, 75, 4)),
    ("back", (506, 664, 242), (75, 5, 75)),
    ("leg_near_left", (506, 594, 0), (15, 5, 242)),
    ("leg_near_right", (566, 594, 0), (15, 5, 242)),
    ("leg_far_left", (506, 664, 0), (15, 5, 242)),
    ("leg_far_right", (566, 664, 0), (15, 5, 242)),
    ("crossbar", (506, 594, 167), (75, 5, 15)),
]
"""Boxes of the published chair: name, lowest corner and extents in millimetres."""


def test_laboratory_of_the_chair_experiment_has_its_transport(built):
    """Mitsuba's points of the wall are the same to 1e-6 m; at the edges of shadows rays differ."""
    camera = """camera: {kind: rectified, film: 63x63, bottom_left: [54.3 cm, 6.4 cm],
         width: 40.1 cm, height: 40.1 cm}
"""
    monitor = """monitor: {width: 0.401625 m, height: 0.305789 m,
          center: [0.2281875 m, 0 m, 0.2916055 m], falloff: {vertical: 18, horizontal: 1}}
"""
    chair = "occluders:\n" + "".join(
        f"  - {{name: {name}, kind: box, anchor: corner, "
        f"position: [{x} mm, {y} mm, {z} mm], width: {width} mm, depth: {depth} mm, "
        f"height: {height} mm}}\n"
        for name, (x, y, z), (width, depth, height) in CHAIR
    )
    wall = "errors: {length: 5 mm}\nwall: {distance: 1.03 m}\n"
    ours = built(wall, camera, monitor, chair, hidden=(8, 10))
    theirs = load_scenario(find_scene("chair"), (8, 10), {"resolution": 63})
    np.testing.assert_allclose(ours.wall_points, theirs.wall_points, atol=3e-6)
    for name in ("patch_centers", "patch_normals", "patch_across", "patch_up"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=1e-7)
    for mine, other in zip(ours.occluders, theirs.occluders, strict=True):
        np.testing.assert_allclose(mine.bounds, other.bounds, atol=1e-7)
    A, expected = (render_transport(scenario, samples=16) for scenario in (ours, theirs))
    assert np.linalg.norm(A - expected) < 2e-3 * np.linalg.norm(expected)
    assert np.mean(np.abs(A - expected) > 1e-4 * expected.max()) < 2e-3
