"""A loaded scene at other values of its parameters, as far as no ray is needed to know it.

Most parameters move, turn or stretch: they change the ``to_world`` matrices of shapes and of the
camera from M to M'. The arrays of the loaded scene then move by M' M^-1, and the camera's rays meet
the wall's plane elsewhere. This is exact while the wall is a plain rectangle and no shape comes
near the camera's view of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.emitters.lcd import EXPONENTS
from periscopy_sim.rendering.scene.document import check_values, read_elements
from periscopy_sim.rendering.scene.placement import SceneLayout, written_layout
from periscopy_sim.scenario import Array, EmissionProfile, Occluder, Scenario, corners

CAMERAS = "orthographic", "perspective"
"""Sensors whose rays through the picture's corners enclose all others."""


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A scenario, and what else Mitsuba knew of its scene when it was loaded."""

    scenario: Scenario
    layout: SceneLayout
    origins: NDArray[np.float32]  # (M, 3) of the rays through the pixels' centres
    directions: NDArray[np.float32]  # (M, 3)
    boxes: Mapping[str, Array]  # (2, 3) lower and upper corner about each shape but the wall

    def at(self, values: Mapping[str, str]) -> Scenario | None:
        """Return the scenario at other values of its file's parameters; None if that takes rays."""
        scenario = self.scenario
        document, elements = read_elements(scenario.path, values)
        check_values(document)
        layout = written_layout(elements, list(self.layout.places))
        motions = self._motions(layout)
        if motions is None:
            return None
        exponents = [layout.exponents.get(name, 0.0) for name in EXPONENTS]
        moved = replace(
            scenario,
            document=document,
            emission=EmissionProfile(*exponents) if layout.exponents else scenario.emission,
            occluders=tuple(
                _moved_occluder(each, motions[each.name]) if each.name in motions else each
                for each in scenario.occluders
            ),
        )
        if "monitor" in motions:
            moved = _with_moved_monitor(moved, motions["monitor"])
        if motions.keys() & {"camera", "wall"}:
            met = self._met_wall(layout.places["wall"], motions.get("camera", np.eye(4)))
            if met is None:
                return None
            moved = replace(moved, wall_points=met[0], wall_normals=met[1])
        return moved if not motions or self._is_wall_in_view(moved.wall_points, motions) else None

    def _motions(self, layout: SceneLayout) -> dict[str, Array] | None:
        """Return the motion, (4, 4), of each thing that moved; None if more than these differs."""
        before, plugins = self.layout, layout.plugins
        is_profile = all(exponent >= 0 for exponent in layout.exponents.values())
        if layout.rest != before.rest or not is_profile:
            return None
        motions = {}
        for name, place in layout.places.items():
            if not np.array_equal(place, before.places[name]):
                # Mitsuba computes in single precision; no comparison is true of NaN.
                is_finite = (np.abs(place) < np.finfo("f4").max).all()
                if not (
                    is_finite and np.linalg.det(place) * np.linalg.det(before.places[name]) > 0
                ):
                    return None
                motions[name] = place @ np.linalg.inv(before.places[name])
        movable = {each.name for each in self.scenario.occluders if each.vertices is not None}
        movable.add("monitor")
        if plugins["wall"] == "rectangle":
            movable |= {"camera", "wall"}
        if motions and not (plugins["camera"] in CAMERAS and motions.keys() <= movable):
            return None
        return motions

    def _met_wall(self, place: Array, camera: Array) -> tuple[Array, Array] | None:
        """Return the points, (M, 3), where a moved camera sees a moved wall, and its normals there.

        None if a ray misses the wall or meets its other side.
        """
        origins, directions = _moved(self.origins, camera), self.directions @ camera[:3, :3].T
        normal, before = _front(place), _front(self.layout.places["wall"])
        ahead = directions @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (place[:3, 3] - origins) @ normal / ahead
            points = origins + distance[:, None] * directions
            to_square = np.asarray(np.linalg.inv(place), np.float64)
            inside = np.abs(_moved(points, to_square)[:, :2]) <= 1
        if not (
            inside.all() and (distance > 0).all() and (ahead * (self.directions @ before) > 0).all()
        ):
            return None
        return points, -np.sign(ahead)[:, None] * normal

    def _is_wall_in_view(self, points: Array, motions: Mapping[str, Array]) -> bool:
        """Return whether planes separate all boxes from the camera's view of the wall."""
        rows, columns = self.scenario.photograph_shape
        ends = [0, columns - 1, rows * columns - 1, (rows - 1) * columns]
        seen = points[ends]
        eyes = _moved(self.origins[ends], motions.get("camera", np.eye(4)))
        sides = np.cross(np.roll(seen, -1, axis=0) - seen, eyes - seen)
        planes = np.concatenate([np.eye(3), sides, [(seen - eyes).sum(axis=0)]]).T
        view = np.concatenate([seen, eyes]) @ planes
        moved = [_moved(corners(b), motions.get(name, np.eye(4))) for name, b in self.boxes.items()]
        boxes = np.stack(moved) @ planes
        beside = (boxes.min(axis=1) > view.max(axis=0)) | (boxes.max(axis=1) < view.min(axis=0))
        return bool(beside.any(axis=1).all())


def _moved(points: NDArray[np.floating[Any]], motion: Array) -> Array:
    """Return points, (n, 3), moved by a matrix, (4, 4)."""
    return points @ motion[:3, :3].T + motion[:3, 3]


def _front(place: Array) -> Array:
    """Return the unit normal of a rectangle."""
    normal = np.cross(place[:3, 0], place[:3, 1])
    return normal / np.linalg.norm(normal)


def _moved_occluder(occluder: Occluder, motion: Array) -> Occluder:
    assert occluder.vertices is not None
    vertices = _moved(occluder.vertices, motion)
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    return replace(occluder, vertices=vertices, bounds=bounds)


def _with_moved_monitor(scenario: Scenario, motion: Array) -> Scenario:
    linear = motion[:3, :3]
    normals = scenario.patch_normals @ np.linalg.inv(linear)
    return replace(
        scenario,
        patch_centers=_moved(scenario.patch_centers, motion),
        patch_normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        patch_across=scenario.patch_across @ linear.T,
        patch_up=scenario.patch_up @ linear.T,
    )
