"""Find an occluder that nobody measured: one convex piece, by the photograph of an unknown picture.

A kind of piece is a scene whose numbers have wide priors: its place in the room between monitor and
wall, its sizes in logarithms, and its turns. For each kind many pieces are drawn, the best ones
evolve, coarse descents follow, and the evidence of their best end, integrated over the numbers
(Laplace's method), chooses the kind.

A piece and its size, scaled about the monitor's middle, cast nearly the same shadows of an image
that is smaller or larger:

    s → k s,   λ = k (1 − t) / (1 − k t)

s the place and size, t the depth over the wall's, λ the image's scale. Smooth images do not tell
these scenes apart, so the likeliest depth among them is arbitrary. Images of few edges do. So the
search follows this ridge through the room, each depth from the last one's solution, and compares
the images' evidence. The ordinary search goes on from the best, and what is nearly as likely on
the ridge widens the errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from heapq import nsmallest
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.dom import minidom
from xml.sax.saxutils import quoteattr

import numpy as np
import trimesh
from scipy import optimize
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from periscopy_sim.analytic.area_transport import wall_plane, ways_to
from periscopy_sim.calibration import calibrated_scene, prior, trust
from periscopy_sim.calibration.calibrate import calibrated
from periscopy_sim.calibration.moving_scene import plain_values
from periscopy_sim.calibration.problem import CalibrationProblem
from periscopy_sim.calibration.resolution_level import Candidate, Look, ResolutionLevel
from periscopy_sim.calibration.result import Calibration, Parameter
from periscopy_sim.calibration.search import (
    COOLING,
    LEAST_GAIN,
    SHARES,
    SPREAD,
    UNLIKELY,
    Place,
    Search,
    descend,
    edged_candidate,
)
from periscopy_sim.errors import PhotographError, SceneError, did_you_mean
from periscopy_sim.hidden import Hidden, Sizes
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import listed
from periscopy_sim.photograph import Photograph, of_one_wall
from periscopy_sim.rendering.load import load_geometry
from periscopy_sim.rendering.scene_files import TriangleMesh, literal, revolved, write_ply
from periscopy_sim.scene import CALIBRATED, CAMERA, RULER_ERROR, Scene
from periscopy_sim.storage.outputs import staged_file
from periscopy_sim.view import Geometry

PIECE = "piece"
"""Id of the shape, and how the names of its numbers begin."""

AXES = tuple(f"{PIECE}_{axis}" for axis in "xyz")


@dataclass(frozen=True)
class Kind:
    """A kind of piece: Mitsuba's shape, its sizes, and its turns with the largest, in degrees."""

    plugin: str
    sizes: Mapping[str, float]  # fraction of its extent that each is, by name
    turns: Mapping[str, float]
    shaping: str  # what makes it of the plugin's own shape, in a room whose wall faces -y, z up
    mesh: Callable[[], TriangleMesh] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its numbers."""
        return (*AXES, *self.logarithmic, *(f"{PIECE}_{name}" for name in self.turns))

    @property
    def logarithmic(self) -> tuple[str, ...]:
        """Names of its sizes."""
        return tuple(f"{PIECE}_{name}" for name in self.sizes)

    def shape(self, mesh: str, upright: str) -> minidom.Element:
        """Return the XML of the shape, given a mesh's file and how the room is turned."""
        file = f'<string name="filename" value={quoteattr(literal(mesh))}/>{FLAT}'
        text = (
            f'<shape type="{self.plugin}" id="{PIECE}">{file if self.mesh else ""}'
            f'<transform name="to_world">{self.shaping}{PLACE}{upright}</transform>{PAINT}</shape>'
        )
        shape: minidom.Element = minidom.parseString(text).childNodes[0]  # type: ignore[assignment]
        return shape


PLACE = '<translate x="$piece_x" y="$piece_y" z="$piece_z"/>'
PAINT = '<bsdf type="diffuse"><rgb name="reflectance" value="0.1"/></bsdf>'
FLAT = '<boolean name="face_normals" value="true"/>'
TURN = '<rotate z="1" angle="$piece_turn"/>'
ROLL = '<rotate y="1" angle="$piece_roll"/>'


def _ball() -> TriangleMesh:
    """Return a ball of radius 1, as wide on average as a sphere."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    # Of a convex body the mean width is Σ (length of an edge) (angle between its faces) / 4 π.
    edges = ball.vertices[ball.face_adjacency_edges]
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    ball.apply_scale(2 / (lengths @ ball.face_adjacency_angles / (4 * np.pi)))
    return TriangleMesh(np.asarray(ball.vertices), np.asarray(ball.faces))


KINDS = {
    "ball": Kind("ply", {"radius": 0.5}, {}, '<scale value="$piece_radius"/>', _ball),
    "box": Kind(
        "cube",
        {"width": 1, "depth": 1, "height": 1},
        {"turn": 45},
        f'<scale value="0.5"/><scale x="$piece_width" y="$piece_depth" z="$piece_height"/>{TURN}',
    ),
    "plate": Kind(
        "rectangle",
        {"width": 1, "height": 1},
        {"turn": 45, "roll": 45},
        '<scale value="0.5"/><scale x="$piece_width" y="$piece_height"/>'
        f'<rotate x="1" angle="90"/>{ROLL}{TURN}',
    ),
    "cylinder": Kind(
        "ply",
        {"radius": 0.5, "height": 1},
        {"roll": 90},
        f'<scale x="$piece_radius" y="$piece_radius" z="$piece_height"/>{ROLL}',
        lambda: revolved(((0, -0.5), (1, -0.5), (1, 0.5), (0, 0.5))),
    ),
}
"""Kinds of pieces. A box turns about the vertical, a cylinder rolls about the wall's normal."""

LEAST, LARGEST = 0.02, 0.3
"""Extents of a piece, over the distance between monitor and wall, if none are given."""

DRAWS, POPULATION, GENERATIONS = 512, 48, 50
"""Pieces of each kind that are compared, those of them that evolve, and how often. The valley of a
box is a fifth of the prior's deviation wide: descents from 2,048 draws miss it, two of four seeds
find it here. With 96 the box of docs/unmeasured.md is not found."""

MUTATION, CROSSOVER = (0.4, 0.9), 0.9
"""Limits of the factor of differences in it, drawn for each generation, and the probability of a
number to change: differential evolution's usual ones."""

COARSE = sum(SHARES[:2])
"""Fraction of a search that its coarse part has, for the progress."""

STEP = 2.0
"""Patches by which the image grows on either side from one scene of the ridge to the next."""

PATTERN, ROUNDS = (2.0, 1.0, 0.5), 2
"""Patches by which images move then, either way across, up and larger, and how often by each."""

MULTIPLES = 2.0, 3.0
"""How many times as large the pattern search makes sizes. Smooth images prefer pieces that are so
many times too small one way: a plate of n times the width casts the shadows of the narrow one, of
an image that is smeared over n places."""

VALLEYS, LIKELY = 4, 8
"""Ends of coarse descents from which the ridge is followed; and scenes there
that images of few edges compare."""

NEAREST = 0.15
"""Depth, over the monitor's distance from the wall, that a piece keeps from either on the ridge."""

HELD = 1e-4
"""Standard deviation of a depth that is held, over that distance."""

RIDGE = 16.0, 4.0, 1.0
"""Temperatures of the descents on the ridge."""

NOISIER, UNEXPLAINED = 1.3, 1e-3
"""Residual over the camera's noise, and over the light, above both of which a piece is not trusted:
a real photograph of a ball leaves 0.03 %."""

PATCHES = 0.5
"""Standard error of the place of the image, or of its border, above which a piece is not trusted;
chosen."""

Range = tuple[float, float]


@dataclass(frozen=True, eq=False)
class OccluderEstimate:
    """One convex piece that explains photographs.

    Attributes
    ----------
    kind
        The likeliest kind.
    probabilities
        Of each kind that was tried, by the evidence of coarse descents and the `SPREAD` of places.
    calibration
        The piece's numbers with their errors. Look at `Calibration.trusted` first; its `scenario`
        is what `Scenario.find_occluder` loads of the scene file, else None.
    files
        The scene file, and its mesh if it has one.
    """

    kind: str
    probabilities: Mapping[str, float]
    calibration: Calibration = field(repr=False)
    files: tuple[Path, ...]

    def record(self) -> dict[str, Any]:
        """Return the result as its JSON file has it."""
        kinds = {"kind": self.kind, "probabilities": self.probabilities}
        return kinds | self.calibration.record()


@dataclass(frozen=True, eq=False)
class Room:
    """Where a piece may be, in the room's axes: along the wall, towards it, and up."""

    scenario: Geometry
    axes: Array  # (3, 3), a column each
    low: Array  # (3,)
    high: Array
    sizes: Range  # extents

    @classmethod
    def of(cls, scenario: Geometry, within: Sequence[Range] | None, sizes: Range | None) -> Room:
        """Return the room before the wall, or the given part; a SceneError says why not."""
        if len(scenario.hidden) > 1:
            raise SceneError(
                f"scene '{scenario.path}': {len(scenario.hidden)} hidden surfaces; a piece can be "
                "found before one"
            )
        wall = wall_plane(scenario.view)
        axes = np.stack([wall.across, -wall.normal, wall.up], axis=1)
        points = np.concatenate([scenario.view.centers, scenario.hidden.centers]) @ axes
        low, high = points.min(axis=0), points.max(axis=0)
        if within is not None:
            box = np.asarray(within, np.float64)
            if box.shape != (3, 2) or not (box[:, 0] < box[:, 1]).all():
                raise SceneError("within: give the least and the largest x, y and z, three pairs")
            low, high = np.maximum(low, box[:, 0]), np.minimum(high, box[:, 1])
        room = cls(scenario, axes, low, high, sizes or (0, 0))
        sizes = sizes or (LEAST * room.distance, LARGEST * room.distance)
        if not 0 < sizes[0] < sizes[1]:
            raise SceneError(f"sizes: {sizes}; give the least and the largest extent, above 0")
        if not (low < high).all() or sizes[0] > room.distance:
            raise SceneError(
                f"scene '{scenario.path}': no room for the piece between monitor and wall; give "
                "another box (within), or smaller sizes"
            )
        return replace(room, sizes=sizes)

    @property
    def middle(self) -> Array:
        """The monitor's, (3,)."""
        return np.asarray(self.scenario.hidden.centers.mean(axis=0) @ self.axes)

    @property
    def distance(self) -> float:
        """From the monitor's middle to the wall."""
        return float((wall_plane(self.scenario.view).center @ self.axes - self.middle)[1])

    def depth(self, point: Array) -> float:
        """Return how far a piece is on its way from the monitor, 0, to the wall, 1."""
        return float((point[1] - self.middle[1]) / self.distance)

    def spans(self, point: Array) -> bool:
        """Return whether a piece may be at a point's depth."""
        inside = self.low[1] <= point[1] <= self.high[1]
        return bool(inside and NEAREST < self.depth(point) < 1 - NEAREST)

    def draws(self, kind: Kind, seed: int) -> Array:
        """Return numbers of a kind's pieces, (J, P), sizes as logarithms, in view of the camera.

        Their places lie evenly along lines from the monitor's middle to places in the picture.
        """
        sizes = [np.log(fraction) + np.log(self.sizes) for fraction in kind.sizes.values()]
        turns = [(-most, most) for most in kind.turns.values()]
        low, high = np.reshape([*sizes, *turns], (-1, 2)).T
        corner, right, _, left = self.scenario.view.corners[1] @ self.axes
        u = qmc.Sobol(len(kind.names), seed=seed).random(64 * DRAWS)
        wall = corner + u[:, 1:2] * (right - corner) + u[:, 2:3] * (left - corner)
        places = self.middle + u[:, :1] * (wall - self.middle)
        inside = ((places > self.low) & (places < self.high)).all(axis=1)
        if np.count_nonzero(inside) < 5:  # fewer do not evolve
            raise SceneError(
                "within: no light from the monitor to what the camera sees of the wall crosses "
                "that box; give another"
            )
        numbers = np.hstack([places, low + u[:, 3:] * (high - low)])
        return np.asarray(numbers[inside][:DRAWS])

    def beside(
        self, kind: Kind, point: Array, hidden: Hidden, light: Array, scale: float, shift: Array
    ) -> Array:
        """Return a point whose piece casts the same shadows of an image that is larger and shifted.

        The image is (N,) light of hidden patches, the shift (2,) patches across and up. A larger
        image moves as little as keeps it on the monitor.
        """
        axes = np.stack([hidden.across[0], hidden.up[0]])
        patch = np.linalg.norm(axes, axis=1)
        axes /= patch[:, None]
        q = (hidden.centers - hidden.centers.mean(axis=0)) @ axes.T
        weights = light / light.sum()
        center = weights @ q
        reach = np.sqrt(3 * weights @ (q - center) ** 2)  # half the side of an even rectangle
        free = np.maximum(np.ptp(q, axis=0) / 2 - scale * reach, 0)
        goal = center + shift * patch if scale == 1 else np.clip(center, -free, free)
        moved, t = point.copy(), self.depth(point)
        factor = scale / (1 - t + scale * t)
        moved[:3] = self.middle + factor * (point[:3] - self.middle)
        moved[:3] += (1 - factor * t) * (goal - scale * center) @ axes @ self.axes
        moved[3 : 3 + len(kind.sizes)] += np.log(factor)
        return moved


@dataclass(frozen=True, eq=False, kw_only=True)
class PieceSearch(Search):
    """A search for the numbers of a piece, which follows the ridge of images of other scales."""

    medium: ResolutionLevel  # of images of few edges in large patches
    room: Room
    kind: Kind
    draws: Array  # (J, P) of the kind's numbers
    drawn = DRAWS + POPULATION * (GENERATIONS + 1)

    @cached_property
    def valleys(self) -> list[Candidate]:
        """The likeliest scenes of the ridges, by smooth images, the best first.

        A descent seldom leaves its depth, so the best ones are followed along the ridge.
        """
        looks = [self.settled(self.coarse, 1, self.coarse.look(each)) for each in self.evolved()]
        return nsmallest(LIKELY, chain.from_iterable(map(self.ridge, looks)), key=_objective)

    def evolved(self) -> list[Candidate]:
        """Return the likeliest pieces, which differ, of a population that evolves from draws.

        By smooth images and no gain, in differential evolution (Storn, Price, J. Glob. Optim. 11,
        1997).
        """

        def cost(numbers: Array) -> float:
            scene = self.coarse.candidate(np.pad(numbers, (0, len(self.coarse.terms))))
            if scene.explanations:
                self.visit(0, scene)
            return scene.cost

        evolved = optimize.differential_evolution(
            cost, [*zip(self.draws.min(axis=0), self.draws.max(axis=0), strict=True)],
            init=np.array(nsmallest(POPULATION, self.draws, key=cost)), maxiter=GENERATIONS,
            mutation=MUTATION, recombination=CROSSOVER, tol=0, atol=LEAST_GAIN, polish=False,
            rng=self.seed,
        )  # fmt: skip
        points = np.pad(evolved.population, ((0, 0), (0, len(self.coarse.terms))))
        costs = [*zip(evolved.population_energies, points, strict=True)]
        return self.distinct([each for each in costs if np.isfinite(each[0])] or costs, VALLEYS)

    def starts(self) -> list[Candidate]:
        """Return the likeliest scene, by images of few edges, which a pattern search moves.

        Descents seldom leave the place of their image, or a size (Hooke, Jeeves, J. ACM 8, 1961).
        """
        level = self.medium
        scenes = [self._held(level, level.candidate(e.point), RIDGE) for e in self.valleys]
        best = min(scenes, key=self._edged_objective)
        least = self._edged_objective(best)
        for move in self._moves():
            for step in move:
                beside = self._held(level, step(best), RIDGE[1:])
                objective = self._edged_objective(beside)
                if objective < least:
                    best, least = beside, objective
                    break
        return [self.fine.candidate(best.point)]

    def _moves(self) -> Iterator[tuple[Callable[[Candidate], Candidate], ...]]:
        """Yield moves of a scene, of which the first that gains counts: larger, or other images."""
        for _ in range(ROUNDS):
            for k in range(len(AXES), len(AXES) + len(self.kind.sizes)):
                yield tuple(partial(self._larger, k, times) for times in MULTIPLES)
        for patches in np.repeat(PATTERN, ROUNDS):
            for way in patches * np.eye(3):
                yield tuple(partial(self._beside, self.medium, patches=w) for w in (way, -way))

    def _larger(self, size: int, times: float, scene: Candidate) -> Candidate:
        """Return a scene one of whose piece's sizes is so many times as large."""
        point = scene.point.copy()
        point[size] += np.log(times)
        return self.medium.candidate(point)

    def _edged_objective(self, scene: Candidate) -> float:
        return edged_candidate(self.medium, scene).objective_at(1) if scene.explanations else np.inf

    def ridge(self, start: Candidate) -> Iterator[Candidate]:
        """Yield coarse scenes of the ridge, one at each depth of the room, beside a start."""
        yield (first := self._held(self.coarse, start, COOLING[-1:]))
        for patches in (STEP, -STEP):
            scene = first
            while scene.explanations:
                moved = self._beside(self.coarse, scene, np.array([0, 0, patches]))
                yield (scene := self._held(self.coarse, moved, COOLING[-1:]))

    def _beside(self, level: ResolutionLevel, scene: Candidate, patches: Array) -> Candidate:
        """Return a scene with another image; no scene where the image is black.

        The image is so many patches, (3,), across, up, and larger on either side.
        """
        light = np.maximum(np.hstack([each.lights for each in scene.explanations]), 0).sum(axis=1)
        if not light.any():
            return Candidate(scene.point, (), np.inf)
        hidden = level.scene.scenario.hidden
        (shape,) = hidden.shapes.values()
        scale = float(np.exp(2 * patches[2] / max(shape)))
        point = self.room.beside(self.kind, scene.point, hidden, light, scale, patches[:2])
        return level.candidate(point)

    def _held(
        self, level: ResolutionLevel, scene: Candidate, temperatures: Sequence[float]
    ) -> Candidate:
        """Return where descents that keep the depth end; no scene where the room has none."""
        if not scene.explanations or not self.room.spans(scene.point):
            return Candidate(scene.point, (), np.inf)
        errors, centers = level.scene.errors.copy(), level.centers.copy()
        errors[1], centers[1] = HELD * self.room.distance, scene.point[1]
        held = replace(level, scene=replace(level.scene, errors=errors), centers=centers)
        look = held.look(held.candidate(scene.point), temperatures[0])
        for T in temperatures:
            look = descend(held, look, T)
        self.visit(1 if level is self.coarse else 2, look)
        return replace(look, penalty=level.penalty(look.point))

    def _lines(
        self, level: ResolutionLevel, here: Place, directions: Sequence[Array], T: float
    ) -> list[list[Place]]:
        """Return likely places across, up, and along the ridge, whose images grow."""

        def moved(patches: float) -> Candidate:
            larger = np.array([0, 0, patches])
            return self._held(level, self._beside(level, here.scene, larger), (T, T))

        sides = super()._lines(level, here, directions[:-1], T)
        return [*sides, self._asides(level, here, moved, T)]

    @cached_property
    def coarse_end(self) -> Look:
        """Where a descent from the likeliest ends."""
        return self.settled(self.coarse, 1, self.coarse.look(self.valleys[0]))

    @property
    def sees_shadows(self) -> bool:
        """Whether a piece explains significantly more than lamps alone."""
        best = self.coarse_end
        lamps = sum(each.freedom * np.log(each.energy).sum() for each in best.explanations)
        return trust.is_significant(lamps - best.cost, len(best.point))

    @property
    def evidence(self) -> float:
        """−2 log of the evidence of the best coarse end, up to a constant, by Laplace's method."""
        best = self.coarse_end
        curved, flat = np.linalg.slogdet(best.curvature())[1], np.sum(np.log(best.precision))
        return float(best.objective + curved - flat)


def _objective(scene: Candidate) -> float:
    return scene.objective_at(1)


def write_piece(
    room: Room, kind: Kind, values: Mapping[str, str], file: Path, remark: str = ""
) -> tuple[Path, ...]:
    """Write a room with a piece, and its mesh beside it if it has one; return the files."""
    mesh = file.with_name(f"{file.stem}_{PIECE}.ply")
    whole = calibrated_scene.with_defaults(room.scenario.document, {}, file.parent, remark)
    turned = np.eye(4)
    turned[:3, :3] = room.axes
    upright = " ".join(f"{each:.9g}" for each in turned.ravel())
    root = whole.getElementsByTagName("scene")[0]
    root.appendChild(kind.shape(mesh.name, f'<matrix value="{upright}"/>'))
    root.appendChild(whole.createTextNode("\n"))
    pairs = values.items()
    defaults = [calibrated_scene.element(whole, "default", name=n, value=v) for n, v in pairs]
    calibrated_scene.prepend(whole, root, defaults)
    with ExitStack() as stack:  # the scene is in its place last
        calibrated_scene.write_document(whole, stack.enter_context(staged_file(file)))
        if kind.mesh is None:
            return (file,)
        write_ply(stack.enter_context(staged_file(mesh)), kind.mesh())
    return file, mesh


def search_for(
    room: Room, kind: Kind, photographs: Sequence[Photograph], file: Path, seed: int,
    progress: Callable[[float], None],
) -> tuple[CalibrationProblem, PieceSearch]:  # fmt: skip
    """Return the problem of a kind of piece, whose scene is written to a file, and its search."""
    bare, draws = room.scenario, room.draws(kind, seed)
    centers, errors = draws.mean(axis=0), draws.std(axis=0)
    start = plain_values(kind.names, centers, kind.logarithmic)
    write_piece(room, kind, {name: f"{value:.9g}" for name, value in start.items()}, file)
    scenario = load_geometry(file, bare.hidden.shapes, camera=bare.view.camera)
    held = prior.uncertain_parameters(scenario.document, kind.names, None)
    problem = CalibrationProblem(
        scenario, kind.names, centers, errors, held, photographs, (), kind.logarithmic, 0
    )  # smooth misfit would pass for another scale
    levels = problem.coarse(), problem.fine(), problem.joint()
    search = PieceSearch(
        *levels, seed, progress, medium=problem.medium(), room=room, kind=kind, draws=draws
    )
    return problem, search


def find_occluder(
    photograph: Photograph | Image | Sequence[Photograph | Image],
    scene: str | Path | Scene,
    hidden: Sizes,
    out: str | Path,
    *,
    kinds: str | Sequence[str] = tuple(KINDS),
    within: Sequence[Range] | None = None,
    sizes: Range | None = None,
    parameters: Mapping[str, str | float] | None = None,
    camera: str = CAMERA,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> OccluderEstimate:
    """Find one convex piece that nobody measured, and write the scene that has it.

    Parameters
    ----------
    photograph, hidden, parameters, camera, seed, progress
        As of `calibrate`; all pictures are unknown.
    scene
        The scene without the piece: wall, camera, monitor, and what else is known.
    out
        The scene to write. A ball or a cylinder has a mesh beside it, ``NAME_piece.ply``.
    kinds
        Some of ``ball``, ``box``, ``plate``, ``cylinder``.
    within
        (least, largest) x, y and z of the piece's middle. By default the box about monitor and
        what the camera sees of the wall.
    sizes
        (least, largest) extent in metres; by default 2 to 30 % of the way from monitor to wall.

    Returns
    -------
    OccluderEstimate
        Look at `Calibration.trusted` first.

    Raises
    ------
    SceneError
        If there is no room for the piece, no such kind, the scene has no closed form, or its
        numbers have the piece's names.
    PhotographError
        If photographs are not of the camera's size, or show no shadow.
    """
    names, out, report = listed(kinds), Path(out), progress or (lambda _: None)
    for name in names:
        if name not in KINDS:
            meant = did_you_mean(name, KINDS) or f"known kinds are {', '.join(KINDS)}"
            raise SceneError(f"kinds: there is no piece '{name}'; {meant}")
    bare = load_geometry(scene, hidden, parameters, camera=camera)
    ways_to(bare)
    room = Room.of(bare, within, sizes)
    photographs = [e.unmixed() for e in of_one_wall(photograph, bare.photograph_shape)]
    with TemporaryDirectory() as folder, threadpool_limits(1):
        done, pairs = dict.fromkeys(names, 0.0), {}

        def advance(name: str, fraction: float) -> None:
            done[name] = fraction
            coarse = np.mean(np.minimum([*done.values()], COARSE)) / COARSE
            report(float(coarse + max(*done.values(), COARSE) - COARSE) / (2 - COARSE))

        for name in names:
            file, part = Path(folder) / f"{name}.xml", partial(advance, name)
            pairs[name] = search_for(room, KINDS[name], photographs, file, seed, part)
        evidence = {name: search.evidence for name, (_, search) in pairs.items()}
        best = min(evidence, key=evidence.__getitem__)
        problem, search = pairs[best]
        if not search.sees_shadows:
            raise PhotographError(
                "the photograph shows no shadow of a piece: lamps explain it as well; check that "
                "the monitor was on, and what the camera sees"
            )
        odds = {name: float(np.exp((evidence[best] - e) / SPREAD)) for name, e in evidence.items()}
        probabilities = {name: each / sum(odds.values()) for name, each in odds.items()}
        result = _plain(calibrated(problem, seed, report, search), problem)
        result = _doubted(result, problem, search, probabilities)
    values = _written(result)
    remark = f"'{PIECE}' is a {best} that a photograph shows"
    if result.doubts:
        remark += f": not trusted: {'; '.join(result.doubts)}"
    files = write_piece(room, KINDS[best], values, out, remark)
    return OccluderEstimate(best, probabilities, result, files)


def _doubted(
    result: Calibration, problem: CalibrationProblem, search: PieceSearch,
    probabilities: Mapping[str, float],
) -> Calibration:  # fmt: skip
    """Return a result that is not trusted where its residual, its image or its kind says so."""
    fine, reasons = search.fine, list[str]()
    light = np.concatenate([each.light.ravel() for each in fine.groups])
    noise = problem.camera_noise(fine.scene.pixels.size)
    grain = np.sqrt(np.mean(noise**2) / np.mean(light**2))
    residual = np.sqrt(np.mean(result.noise**2))
    if residual > max(NOISIER * grain, UNEXPLAINED):
        reasons.append(
            f"{residual:.2%} of the light stays unexplained: the occluder has another form, or is "
            "more than one piece"
        )
    # How far errors of the piece's place move an image whose shadows stay.
    hidden, (x, y, z) = problem.hidden, (p.statistical_error for p in result.parameters[:3])
    t = search.room.depth(np.array([result.parameters[k].value for k in range(3)]))
    across, up = np.linalg.norm(hidden.across[0]), np.linalg.norm(hidden.up[0])
    (shape,) = hidden.shapes.values()
    larger = y / search.room.distance / t * max(shape) / 2
    patches = float(np.max([x / across, z / up, larger])) / (1 - t)
    if patches > PATCHES:
        reasons.append(
            f"the photograph leaves the image's place uncertain by {patches:.1f} patches, or its "
            "size; bound the piece's size or place"
        )
    best = max(probabilities.values())
    if others := [n for n, each in probabilities.items() if UNLIKELY < each < best]:
        reasons.append(f"it may as well be a {' or a '.join(others)}; name the kind if you know it")
    if not reasons:
        return result
    numbers = tuple(replace(each, trusted=False) for each in result.parameters)
    return replace(result, doubts=(*result.doubts, *reasons), parameters=numbers)


def _plain(result: Calibration, problem: CalibrationProblem) -> Calibration:
    """Return a result whose sizes are lengths, not logarithms."""
    logs, names = problem.logarithmic, problem.names
    factors = {p.name: float(np.exp(p.value)) if p.name in logs else 1.0 for p in result.parameters}

    def plain(p: Parameter) -> Parameter:
        if p.name not in logs:
            return p
        size = factors[p.name]
        errors = (size * e for e in (p.statistical_error, p.standard_error, p.ruler_error))
        return Parameter(p.name, float(np.exp(p.start)), size, *errors, trusted=p.trusted)

    is_log = np.isin([*names, ""], logs)
    return replace(
        result,
        parameters=tuple(map(plain, result.parameters)),
        moves=result.moves * np.array([*factors.values()])[:, None],
        path=tuple(np.where(is_log, np.exp(np.where(is_log, r, 0)), r) for r in result.path),
        rivals=tuple(
            replace(r, values=plain_values(names, np.array([*r.values.values()]), logs))
            for r in result.rivals
        ),
    )


def _written(result: Calibration) -> dict[str, str]:
    """Return the ``<default>``s of a piece's scene."""
    numbers = {p.name: p.value for p in result.parameters}
    numbers |= {f"{p.name}{RULER_ERROR}": p.ruler_error for p in result.parameters}
    values = {name: f"{value:.9g}" for name, value in numbers.items()}
    return {**values, CALIBRATED: result.scene_covariance.text()}
