"""Occluders that stand in each other."""

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.rendering.overlap import overlap_doubt, overlaps, swallowed, winding_number

CUBE = """<shape type="cube" id="{name}"><transform name="to_world"><scale value="{size}"/>
<translate x="0.2" y="{y}" z="0.25"/></transform><bsdf type="diffuse"/></shape>"""
ROUND = """<shape type="{kind}" id="{name}"><transform name="to_world"><scale value="{size}"/>
<translate x="0.2" y="{y}" z="0.25"/></transform><bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
</shape>"""


@pytest.fixture
def scene(tmp_path):
    """Return a scene of the plate's laboratory with shapes in the plate's place."""

    def made(*shapes):
        text = ps.find_scene("plate").read_text("utf-8")
        while (start := text.find('<shape type="cube"')) >= 0:
            text = text[:start] + text[text.index("</shape>", start) + len("</shape>") :]
        path = tmp_path / "lab.xml"
        path.write_text(text.replace("</scene>", "".join(shapes) + "</scene>"), "utf-8")
        return ps.load_scenario(path, (2, 2), {"resolution": 12})

    return made


def cube(name, y, size=0.02):
    return CUBE.format(name=name, y=y, size=size)


def test_boxes_that_touch_or_stand_apart_do_not_overlap(scene):
    assert overlaps(scene(cube("one", 0.5), cube("other", 0.54))) == {}
    assert overlaps(scene(cube("one", 0.5), cube("other", 0.6))) == {}


def test_boxes_a_quarter_in_each_other_overlap_by_as_much(scene):
    found = overlaps(scene(cube("one", 0.5), cube("other", 0.53)))
    # Of the six faces one lies within, and a quarter of four.
    assert found == {
        ("one", "other"): pytest.approx(2 / 6, abs=0.06),
        ("other", "one"): pytest.approx(2 / 6, abs=0.06),
    }


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_a_box_within_a_round_body_casts_no_shadow_of_its_own(scene, kind):
    body = ROUND.format(kind=kind, name="body", y=0.5, size=0.1)
    shift = 0.02 if kind == "sphere" else 0.0
    within = scene(body, cube("box", 0.5 + shift, 0.01))
    if kind == "cylinder":  # it stands on its end at z 0.25, where the box is half below it
        assert 0 < overlaps(within)["box", "body"] < 1
        return
    assert swallowed(within) == [
        "occluder 'box' lies within 'body', and so casts no shadow of its own"
    ]
    assert swallowed(scene(body, cube("box", 0.6, 0.01))) == []


def test_parts_of_the_chair_are_joined_and_no_doubt_is_left_of_them():
    chair = ps.load_scenario("chair", (2, 2), {"resolution": 12})
    joined = overlaps(chair)
    assert ("chair_crossbar", "chair_leg_near_left") in joined
    assert overlap_doubt(chair, but=joined) == "" and swallowed(chair) == []
    assert "3 more pairs stand in each other" in overlap_doubt(chair)


def test_winding_number_is_one_within_and_none_outside_whichever_way_triangles_turn():
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
    tetrahedron = corners[[(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]]
    points = np.array([(0.1, 0.1, 0.1), (0.2, 0.2, 1e-6), (0.2, 0.2, -1e-6), (1, 1, 1)])
    for triangles in (tetrahedron, tetrahedron[:, ::-1]):
        np.testing.assert_allclose(winding_number(points, triangles), [1, 1, 0, 0], atol=1e-12)


def test_winding_number_agrees_with_the_planes_of_a_convex_mesh():
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(0)
    corners = rng.standard_normal((60, 3))
    hull = ConvexHull(corners)
    triangles = corners[hull.simplices]  # each turned one way or the other
    outward = hull.equations[:, :3]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    turned = np.sum(normals * outward, axis=1) < 0
    triangles[turned] = triangles[turned, ::-1]
    points = rng.uniform(-2, 2, (400, 3))
    inside = (points @ outward.T + hull.equations[:, 3] < 0).all(axis=1)
    assert 0.05 < inside.mean() < 0.95
    np.testing.assert_allclose(winding_number(points, triangles), inside, atol=1e-9)
