"""A past faces that clip patches: as by outlines, as by half-spaces, and of curved surfaces."""

from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import area_derivatives, area_transport, way_to
from periscopy_sim.hidden import GAUSS, Hidden, Surface
from periscopy_sim.scenario import Scenario
from tests.scenes.boxes import LAMBERTIAN, Box, changed, make_scenario, oracle

RADIUS = 0.6


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


def by_faces(scenario):
    return way_to(scenario, "monitor", by_faces=True).light()


@pytest.mark.parametrize("scene", ["chair", "plate"])
def test_clipping_leaves_what_outlines_leave(scene):
    """Two closed forms that share no code but the light's formula."""
    scenario = ps.load_scenario(scene, (12, 13), photograph=(14, 13))
    by_outlines = area_transport(scenario)
    assert relative(by_faces(scenario), by_outlines) < 1e-4


@pytest.mark.parametrize("y", [0.05, 0.98])
def test_occluders_may_reach_past_the_wall_and_the_monitor(y):
    """Of 1,600 samples a border crosses 80, each half wrong."""
    boxes = [Box((0.4, y, 0.25), (0.1, 0.3, 0.1))]
    scenario = make_scenario([boxes[0].occluder()], film=(3, 4))
    seen = scenario.view.points[:, 0]
    outside = (np.abs(seen - boxes[0].center) > boxes[0].half).any(axis=1)
    A = area_transport(scenario)[outside]
    assert (A.min(axis=0) < 0.5 * A.max(axis=0)).any()
    assert relative(A, oracle(scenario, (40, 40), boxes)[outside]) < 9e-3


def bowl(shape, hollow=1):
    """A part of a sphere before the wall, hollow to it, or -1 for bulging; no Mitsuba."""

    def grid(parts, offsets):
        rows, columns = parts * shape[0], parts * shape[1]
        row, column = np.divmod(np.arange(rows * columns), columns)
        u = 0.9 * ((column // parts + offsets[column % parts]) / shape[1] - 0.5)
        v = 0.7 * (0.5 - (row // parts + offsets[row % parts]) / shape[0])
        outward = np.stack([-np.sin(u) * np.cos(v), -np.cos(u) * np.cos(v), np.sin(v)], axis=1)
        across = np.stack([-np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), 0 * u], axis=1)
        up = np.stack([np.sin(u) * np.sin(v), np.cos(u) * np.sin(v), np.cos(v)], axis=1)
        turn = np.array([1, hollow, 1])
        centers = np.array([0.3, 0.5 * hollow, 0.3]) + RADIUS * outward * turn
        edges = [
            each * RADIUS * size * turn
            for each, size in ((across, 0.9 / columns), (up, 0.7 / rows))
        ]
        normals = -hollow * outward * turn
        return Surface((rows, columns), centers, normals, *edges)

    places = 0.5 + np.array([-GAUSS, GAUSS])
    return replace(grid(1, np.array([0.5])), curved=grid(2, places))


def curved_scenario(shape, boxes=(), hollow=1):
    scenario = make_scenario([box.occluder() for box in boxes], film=(4, 5), emission=LAMBERTIAN)
    return Scenario(scenario.view, Hidden({"monitor": bowl(shape, hollow)}))


@pytest.mark.parametrize("hollow", [1, -1])
def test_a_curved_patch_sends_the_light_of_many_flat_ones(hollow):
    boxes = [Box((0.45, 0.6, 0.3), (0.12, 0.1, 0.1))]
    A = area_transport(curved_scenario((6, 8), boxes, hollow))
    # As parallelograms without Gauss points of their own, whose error falls with their area.
    fine = curved_scenario((96, 128), boxes, hollow)
    flat = Hidden({"monitor": replace(fine.hidden["monitor"], curved=None)})
    exact = by_faces(Scenario(fine.view, flat))
    exact = exact.reshape(-1, 6, 16, 8, 16).sum(axis=(2, 4)).reshape(A.shape)
    assert relative(A, exact) < 2e-3
    assert A.sum() == pytest.approx(exact.sum(), rel=5e-4)
    without = area_transport(curved_scenario((6, 8), (), hollow))
    assert relative(without, exact) > 0.1


def test_derivatives_of_curved_surfaces_are_differences():
    scenario = curved_scenario((6, 8), [Box((0.45, 0.6, 0.3), (0.12, 0.1, 0.1))])

    def beside(distance):
        (box,) = scenario.scene.occluders
        moved = replace(box, vertices=box.vertices + np.array([distance, 0, 0]))
        return Scenario(
            replace(scenario.view, scene=replace(scenario.scene, occluders=(moved,))),
            scenario.hidden,
        )

    A, (slope,) = area_derivatives(scenario, [(beside(1e-5), 1e-5)])
    np.testing.assert_allclose(A, area_transport(scenario), rtol=1e-6)
    step = 2e-3
    wide = (area_transport(beside(step)) - area_transport(beside(-step))) / (2 * step)
    assert relative(slope.sum(axis=1), wide.sum(axis=1)) < 0.02


def test_derivatives_by_faces_are_those_of_outlines():
    """Though wall points pass from one side of a face to its other before the scene beside."""
    scenes = [
        ps.load_scenario("chair", (6, 7), {"occluder_dx": dx}, photograph=(16, 16))
        for dx in (0.0, 0.0001)
    ]
    (_, (exact,)), (_, (slope,)) = (
        own.linearized([(beside, 1e-4)])
        for own, beside in (
            [way_to(each, "monitor", by_faces=by_faces) for each in scenes]
            for by_faces in (False, True)
        )
    )
    assert relative(slope, exact) < 2e-3  # all of the way, 0.18


def test_a_face_in_the_monitors_plane_or_edge_on_hides_nothing():
    frame = Box((0.23, -0.02, 0.29), (0.5, 0.04, 0.4))  # its front lies in the plane
    fin = Box((0.74, 0.9, 0.26), (0.0, 0.05, 0.05))
    scenario = make_scenario([frame.occluder("frame")])
    hidden, seen = (by_faces(each) for each in (scenario, make_scenario()))
    np.testing.assert_allclose(hidden, seen, rtol=1e-5)
    seen = area_transport(changed(scenario, scene={"occluders": (fin.occluder("fin"),)}))
    assert np.isfinite(seen).all()
