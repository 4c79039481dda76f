"""Ambient light: the wall as lit by everything but the hidden monitor.

Brute force would need hours to push its noise below a camera's. But irradiance is smooth where no
shadow falls. So direct light, from each emitter apart, and light that has bounced are estimated in
independent replicas, and smoothed as far as these allow; samples are added where they gain most,
until the whole is as exact as asked for.
"""

import itertools
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
from periscopy_sim.geometry import Geometry
from periscopy_sim.measurement import TARGET
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.machine import rising
from periscopy_sim.numerics.validation import checked_number
from periscopy_sim.rendering.ambient.irradiance import BouncedIrradiance, direct_irradiance
from periscopy_sim.rendering.scene.checks import check_media
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.rendering.scene.wall import camera_of, look, map_points, shape_of
from periscopy_sim.rendering.variant import dr, mi, require_vectorized
from periscopy_sim.rendering.wall_polynomials import REPLICAS, FieldFit, best_fit, chosen_sites
from periscopy_sim.shipped import find_scene
from periscopy_sim.view import LIFT, View, WallFrame, pixel_edges, rises, wall_frame

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
        irradiance, errors = refined(parts, target, max_rounds, seeds, rising(progress))
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
    errors_of, target = errors_of or relative_errors, checked_number(target, "target", 0)
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
    check_media(nodes)
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
        ray, si = look(scene, camera_of(scene), film)
        is_wall = si.shape == mi.ShapePtr(shape_of(scene, "wall"))
        return si.p, si.n * -dr.sign(dr.dot(si.n, ray.d)), is_wall

    def meet_grid(side: int) -> tuple[Array, Array]:
        film = (np.indices((side, side))[::-1].reshape(2, -1).T + 0.5) / side
        points, normals, on_wall = map_points(meet, film)
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
