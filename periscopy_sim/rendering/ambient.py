"""Ambient light: the wall as lit by everything but the hidden monitor.

Brute force would need hours to push its noise below a camera's. But irradiance is smooth where no
shadow falls. So direct light, from each emitter apart, and light that has bounced are estimated in
independent replicas, and smoothed as far as these allow; samples are added where they gain most,
until the whole is as exact as asked for.

Light that has bounced comes from the same surfaces for every point of a wall. So what a ray from
one point meets serves all: that another could have found it, too, the balance heuristic ([1] of
`paths`) takes into account, at the price of a shadow ray for each pair. Hence several paths go on
from there.
"""

import itertools
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from periscopy_sim.errors import SceneError
from periscopy_sim.measurement import TARGET
from periscopy_sim.numerics import Array, machine, validation
from periscopy_sim.rendering import load, wall
from periscopy_sim.rendering.nodes import SceneNodes
from periscopy_sim.rendering.paths import PathNumbers, trace_paths
from periscopy_sim.rendering.variant import LANES, dr, mi, require_vectorized
from periscopy_sim.rendering.wall_polynomials import REPLICAS, FieldFit, best_fit, chosen_sites
from periscopy_sim.shipped import find_scene
from periscopy_sim.view import LIFT, Geometry, View, WallFrame, pixel_edges, rises, wall_frame

SPLIT = 4
"""Paths that go on from what a ray first meets: in a room with windows nine tenths of what a path
varies by come from further on, and to ask all points for that surface takes as long as two."""


def direct_irradiance(
    scene: Any, emitter: Any, points: Array, normals: Array, edges: Array, samples: int, seed: int
) -> Array:
    """Estimate the irradiance (M, 3) that one emitter causes, averaged over small parallelograms.

    They have (M, 3) centres and unit normals and (M, 2, 3) edge vectors. Rays aimed at the emitter
    and cosine-weighted ones, `samples` of each rounded up to a square number, are combined by the
    balance heuristic. The seed is of 32 bits.
    """
    count = math.ceil(math.sqrt(samples)) ** 2
    sampler = mi.load_dict({"type": "multijitter", "sample_count": count})
    sampler.set_samples_per_wavefront(count)
    sampler.seed(seed, len(points) * count)
    index = dr.arange(mi.UInt32, len(points) * count) // count
    within = sampler.next_2d()
    down, across = (gathered(mi.Vector3f, edges[:, k], index) for k in range(2))
    position = gathered(mi.Point3f, points, index)
    position += (within.x - 0.5) * down + (within.y - 0.5) * across
    normal = gathered(mi.Normal3f, normals, index)
    si = dr.zeros(mi.SurfaceInteraction3f, len(points) * count)
    si.p, si.n, si.sh_frame, si.wi = position, normal, mi.Frame3f(normal), mi.Vector3f(0, 0, 1)
    toward, weight = emitter.sample_direction(si, sampler.next_2d())
    cosine = dr.maximum(dr.dot(normal, toward.d), 0)
    lit = (cosine > 0) & (toward.pdf > 0)
    blocked = scene.ray_test(mi.Ray3f(position, toward.d, nearly(toward.dist), 0.0, []), lit)
    aimed = dr.select(toward.delta, 1, toward.pdf / (toward.pdf + cosine * dr.inv_pi))
    arriving = dr.select(lit & ~blocked, weight * cosine * aimed, 0)
    if not mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta):
        # Rays are aimed at texels as if no to_uv turned them: what they miss is met by chance.
        direction = si.sh_frame.to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
        hit = scene.ray_intersect(mi.Ray3f(position, direction))
        chance = dr.dot(normal, direction) * dr.inv_pi
        pdf = emitter.pdf_direction(si, mi.DirectionSample3f(scene, hit, si))
        met = (hit.emitter(scene) == dr.opaque(mi.EmitterPtr, emitter)) & (chance > 0)
        arriving += dr.select(met, emitter.eval(hit) * dr.pi * chance / (chance + pdf), 0)
    dr.eval(arriving)  # else computed anew for each component
    return rows_of(dr.block_reduce(dr.ReduceOp.Add, arriving, count)) / count


class BouncedIrradiance:
    """Estimates of the irradiance by light that has bounced, at (m, 3) points just off one wall.

    So many rays are sent from each point; from what each meets, `SPLIT` paths go on.
    """

    def __init__(self, scene: Any, points: Array, normals: Array, rays: int) -> None:
        self._scene, self._points, self._normals, self._rays = scene, points, normals, rays
        self._numbers = PathNumbers(len(points), (rays, (SPLIT - 1) * rays))

    def estimate(self, seed: int) -> Array:
        """Return the irradiance, (m, 3), as estimated by a seed."""
        m = len(self._points)
        light, hits = self._trace(seed)
        irradiance = np.zeros((m, 3))
        at_once = max(1, LANES // m)  # pairs of a path and a point
        for first in range(0, len(light), at_once):
            some = np.arange(first, min(first + at_once, len(light)), dtype=np.uint32)
            form = self._form_factors(some, hits)
            # Σ_j n_j p_j of a hit: the density with which the rays of all points find it.
            found = self._rays * form.sum(axis=1, keepdims=True)
            weight = np.divide(form, found, where=found > 0, out=np.zeros_like(form))
            irradiance += np.pi * weight.T @ light[some]
        return irradiance

    def _trace(self, seed: int) -> tuple[Array, tuple[Any, ...]]:
        """Trace rays in cosine-weighted directions, and the paths that go on from them.

        Return the radiance that each ray brings, (rays, 3), and what all paths first meet, those
        of the rays before others, as `trace_paths` does.
        """
        m, n = len(self._points), self._rays
        numbers = self._numbers.shifted(seed)
        ray_of = np.arange(m * n).reshape(m, 1, n)
        ray_of = mi.UInt32(
            np.concatenate([ray_of.ravel(), np.repeat(ray_of, SPLIT - 1, axis=1).ravel()])
        )
        frame = mi.Frame3f(gathered(mi.Normal3f, self._normals, ray_of // n))
        sample = (dr.gather(mi.Float, numbers(k), ray_of) for k in range(2))
        direction = frame.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(*sample)))
        ray = mi.Ray3f(gathered(mi.Point3f, self._points, ray_of // n), direction)
        light, hits = trace_paths(self._scene, numbers, 2, ray)
        dr.eval(light, hits)
        first, others = np.split(rows_of(light), [m * n])
        others = others.reshape(m, SPLIT - 1, n, 3).sum(axis=1).reshape(m * n, 3)
        return (first + others) / SPLIT, hits

    def _form_factors(self, paths: NDArray[np.uint32], hits: tuple[Any, ...]) -> Array:
        """Return the density of each hit from each point: cosines over π r², 0 where unseen."""
        m = len(self._points)
        pair = dr.arange(mi.UInt32, len(paths) * m)
        path, index = dr.opaque(mi.UInt32, int(paths[0])) + pair // m, pair % m
        own = path // self._rays == index
        position, toward_wall = (
            dr.gather(kind, hits[k], path) for k, kind in enumerate((mi.Point3f, mi.Normal3f))
        )
        valid, diffuse = (dr.gather(mi.Bool, hits[k], path) for k in (2, 3))
        point = gathered(mi.Point3f, self._points, index)
        away = position - point
        distance = dr.norm(away)
        direction = away / distance
        at_wall = dr.dot(gathered(mi.Normal3f, self._normals, index), direction)
        at_hit = -dr.dot(toward_wall, direction)
        # A surface that scatters unequally by direction serves only the path's own point.
        seen = valid & (own | diffuse) & (at_wall > 0) & (at_hit > 0)
        ray = mi.Ray3f(point, direction, nearly(distance), 0.0, [])
        blocked = self._scene.ray_test(ray, seen & ~own)
        form = dr.select(seen & ~blocked, at_wall * at_hit / (dr.pi * dr.square(distance)), 0)
        return np.array(form, dtype=np.float64).reshape(len(paths), m)


def nearly(distance: Any) -> Any:
    """Return how far a shadow ray goes, short of touching the surface at a distance."""
    return distance * (1 - mi.math.ShadowEpsilon)


def gathered(kind: Any, rows: Array, index: Any) -> Any:
    """Return rows, (n, components), at an index, as a Dr.Jit vector of a kind."""
    return dr.gather(kind, kind(np.ascontiguousarray(rows.T, np.float32)), index)


def rows_of(values: Any) -> NDArray[np.float64]:
    """Return (n, components) of a Dr.Jit vector."""
    return np.stack([np.array(component, dtype=np.float64) for component in values], axis=1)


RAYS = 256
"""Rays from each site of bounced light in a round."""

RAY = 100
"""Time of such a ray, with the paths that go on from what it meets and its shadow rays, over that
of a sample of direct light: measured in a room with windows."""

DIRECT_SAMPLES = 64
"""Samples of each emitter and pixel in a round."""

GRID = 33
"""Rays along each side of a place's camera that must meet its wall: of 3 % of it, nothing hides."""


@dataclass(frozen=True, eq=False)
class Background:
    """A photograph of ambient light and its Monte Carlo error.

    Attributes
    ----------
    photograph
        (rows, columns, 3) radiance.
    relative_error
        Error of a pixel (standard error and bias of the smoothing) relative to its brightness, root
        mean square over pixels and channels, after the one factor by which a composite scales the
        whole.
    brightness_error
        Relative standard error of that factor; the root of both squares' sum is the whole error.
    warnings
        What the reader of a photograph's file had to assume, one line each.
    """

    photograph: Array = field(repr=False)
    relative_error: float
    brightness_error: float
    warnings: tuple[str, ...] = field(default=(), kw_only=True)


def render_background(
    path: str | Path,
    scenario: Geometry,
    parameters: Mapping[str, str] | None = None,
    *,
    target: float = TARGET,
    max_rounds: int = 64,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Background:
    """Photograph a scenario's wall in an ambient scene, path traced.

    The ambient scene is moved, turned and scaled as a whole, so that what its own camera sees of
    its own wall encloses, with the same centre and axes, what the scenario's camera sees. The wall
    takes the scenario's reflectance; light between it and its surroundings is that of the ambient
    scene's wall.

    Parameters
    ----------
    path
        A scene file, or the name of a shipped one such as ``ambient/overcast``, with shape ``wall``
        and sensor ``camera``, without a monitor.
    scenario
        The scene whose camera photographs.
    parameters
        Values for the ambient scene's ``<default>``s.
    target
        Relative error of a pixel, both parts together, at which to stop.
    max_rounds
        Most rounds of samples for each part of the light, each of the time of the first.
    seed
        Seed of every sampler. The same seed and variant give the same picture, but for the last
        digit of single precision: in a scene loaded anew a ray rarely takes another path.
    progress
        Called with the fraction done, as estimated from the first round of all parts on.

    Raises
    ------
    SceneError
        If the ambient scene lacks wall, camera or light, its camera does not see its wall, or the
        scenario's wall is not diffuse.
    VariantError
        In scalar variants.

    Warns
    -----
    RuntimeWarning
        The target was not reached within `max_rounds`.
    """
    require_vectorized("ambient light")
    view = scenario.view
    if view.reflectance is None:
        raise SceneError(
            f"scene '{scenario.path}': ambient light needs a diffuse wall; give the wall a BSDF of "
            "type diffuse"
        )
    path = find_scene(path)
    scene, points, normals = placed_in(path, view, parameters)
    surface = points, normals, pixel_edges(points, normals, view.shape), DIRECT_SAMPLES
    direct = [partial(direct_irradiance, scene, each, *surface) for each in scene.emitters()]
    sites, everywhere = chosen_sites(view.shape), np.arange(len(points))
    bounced = BouncedIrradiance(scene, points[sites], normals[sites], RAYS).estimate
    parts = [
        *(Part(each, everywhere, view.shape, len(points) * DIRECT_SAMPLES) for each in direct),
        Part(bounced, sites, view.shape, len(sites) * RAYS * RAY),
    ]
    states = (np.random.SeedSequence([seed, k]).generate_state(1) for k in itertools.count())
    seeds = (int(state[0]) for state in states)
    with threadpool_limits(1):  # the last bits follow the number of threads
        irradiance, errors = refined(parts, target, max_rounds, seeds, machine.rising(progress))
    if not irradiance.any():
        raise SceneError(
            f"scene '{path}': no light reaches its wall; move its emitters or its wall"
        )
    error = float(np.linalg.norm(errors))
    if error > target:
        warnings.warn(
            f"'{path.stem}' stopped at a relative error of {error:.1e}, above {target:.1e}, after "
            f"{max_rounds} rounds of samples; raise max_rounds, or accept it as the target",
            RuntimeWarning,
            stacklevel=2,
        )
    picture = irradiance * view.reflectance / np.pi
    return Background(picture.reshape(*view.shape, 3), *errors)


@dataclass(eq=False)
class Part:
    """One part of the light, estimated in replicas at some of the pixels."""

    estimate: Callable[[int], Array]  # maps a seed to the (S, 3) irradiance at the sites
    sites: NDArray[np.intp]  # (S,) row-major indices of pixels
    shape: tuple[int, int]  # of the photograph
    work: float = 1.0  # time of a round, in any unit
    rounds: int = 0  # how often samples were added
    fit: FieldFit = field(init=False)  # after the first round
    _sum: Any = 0.0

    def add_round(self, seeds: Iterator[int]) -> None:
        """Add samples to every replica, and estimate the field anew."""
        self._sum += np.array([self.estimate(next(seeds)) for _ in range(REPLICAS)])
        self.rounds += 1
        self.fit = best_fit(self._sum / self.rounds, self.sites, self.shape)


def refined(
    parts: list[Part],
    target: float,
    max_rounds: int,
    seeds: Iterator[int],
    progress: Callable[[float], None],
    errors_of: "Callable[[Array, Array], tuple[float, ...]] | None" = None,
) -> tuple[Array, tuple[float, ...]]:
    """Add rounds where they gain most for their time until the whole is as exact as the target.

    Return the light, (M, 3), and its errors: `relative_errors`, or what `errors_of` makes of the
    same arguments. The root of their squares' sum is what the target bounds.
    """
    errors_of, target = errors_of or relative_errors, validation.checked_number(target, "target", 0)
    for part in parts:
        part.add_round(seeds)
    work = np.array([part.work for part in parts])
    while True:
        rounds, fits = np.array([part.rounds for part in parts]), [part.fit for part in parts]
        whole, bias = sum(fit.replicas for fit in fits), sum(fit.squared_bias for fit in fits)
        mean, errors = np.mean(whole, axis=0), errors_of(np.asarray(whole), np.asarray(bias))
        error = float(np.linalg.norm(errors))
        if error <= target or rounds.min() >= max_rounds:
            return mean, errors
        alone = [(mean + f.replicas - f.replicas.mean(axis=0), f.squared_bias) for f in fits]
        # With the noise the bias falls: more is known of it, and higher powers serve better.
        squared = np.square([errors_of(*each) for each in alone]).sum(axis=1)
        # One more round of n takes 1 / (n + 1) off a part's squared error.
        gain = np.where(rounds < max_rounds, squared / (rounds + 1) / work, -1)
        progress(max(float(rounds.mean()) / max_rounds, (target / error) ** 2))
        parts[int(gain.argmax())].add_round(seeds)


def relative_errors(replicas: Array, squared_bias: Array) -> tuple[float, ...]:
    """Return the relative and the brightness error of the replicas' mean, as `Background` has them.

    `replicas` are (K, M, 3) independent estimates of a picture, `squared_bias` (3,) of them all.
    """
    K = len(replicas)
    brightness = replicas.mean(axis=(1, 2))
    if not brightness.any():
        return 0.0, 0.0
    scaled = replicas / brightness[:, None, None]
    variance = scaled.var(axis=0, ddof=1) / K + squared_bias / brightness.mean() ** 2
    pixel = scaled.mean(axis=(0, 2))
    # A pixel that is dark in every replica has no error.
    lit = pixel != 0
    relative = np.sqrt((variance[lit] / pixel[lit, None] ** 2).sum() / variance.size)
    return float(relative), float(brightness.std(ddof=1) / np.sqrt(K) / brightness.mean())


def placed_in(
    path: Path, seen: View, parameters: Mapping[str, str] | None
) -> tuple[Any, Array, Array]:
    """Return an ambient scene, and a view's points and normals, (M, 3), moved into it.

    A SceneError says that it has no light or a medium, or its camera does not see its wall.
    """
    nodes = SceneNodes(path, parameters, required={"wall": "Shape", "camera": "Sensor"})
    load.check_media(nodes)
    nodes.average_pixels()
    scene = nodes.instantiate()
    if not scene.emitters():
        raise SceneError(f"scene '{path}' has no emitter; give it light")
    view, lift, half = _view_of(scene, path)
    points, normals, own = seen.centers, seen.center_normals, seen.frame
    offsets, sides = points - own.center, np.stack([own.across, own.up], axis=1)
    edges = seen.edges @ sides
    reach = (np.abs(offsets @ sides) + np.abs(edges).sum(axis=1) / 2).max(axis=0)
    scale = float(f"{(half / reach).min():.4g}")  # rounded: the points are of single precision
    axes, axes_there = ([each.across, each.normal, each.up] for each in (own, view))
    turn = np.transpose(axes) @ np.array(axes_there)
    height = np.maximum(lift, scale * rises(points, normals, seen.shape))
    # A wall that bends lies on the place's wall by its lowest point.
    lowest = lift * np.round(scale * (offsets @ own.normal).min() / lift)
    lifted = scale * offsets - lowest * own.normal + height[:, np.newaxis] * normals
    return scene, lifted @ turn + view.center, normals @ turn


def _view_of(scene: Any, path: Path) -> tuple[WallFrame, float, Array]:
    """Return the centre and axes of what the ambient scene's camera sees of its wall.

    And the height of points just off the wall, and how far it sees at least, across and up.
    """

    def meet(film: Any) -> tuple[Any, ...]:
        ray, si = wall.look(scene, wall.camera_of(scene), film)
        is_wall = wall.is_shape(si, wall.shape_of(scene, "wall"))
        return si.p, si.n * -dr.sign(dr.dot(si.n, ray.d)), is_wall

    def meet_grid(side: int) -> tuple[Array, Array]:
        film = (np.indices((side, side))[::-1].reshape(2, -1).T + 0.5) / side
        points, normals, on_wall = wall.map_points(meet, film)
        if not on_wall.all():
            raise SceneError(
                f"scene '{path}': its camera does not see its wall alone; move what stands between"
            )
        return points, normals

    points, normals = meet_grid(3)
    view = wall_frame(points, normals, (3, 3))
    offsets = meet_grid(GRID)[0].reshape(GRID, GRID, 3) - view.center
    sides = offsets[:, [0, -1]] @ view.across, offsets[[0, -1]] @ view.up
    half = np.array([np.abs(side).min() for side in sides]) * GRID / (GRID - 1)
    return view, LIFT * 1.5 * float(np.linalg.norm(np.ptp(points, axis=0))), half
