"""Ambient light: the wall as lit by everything but the hidden monitor.

Brute force would need hours to push its noise below a camera's. But irradiance is smooth where no
shadow falls. So direct light, from each emitter apart, and light that has bounced are estimated in
independent replicas, and smoothed as far as these allow; samples are added where
the error is largest, until the whole is as exact as was asked for.
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

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.ambient.irradiance import BouncedIrradiance, direct_irradiance
from periscopy_sim.rendering.scene.load import camera_of, shape_of
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.rendering.scene.refusals import check_media
from periscopy_sim.rendering.scene.wall import map_points
from periscopy_sim.rendering.variant import dr, mi, require_vectorized
from periscopy_sim.rendering.wall_polynomials import REPLICAS, FieldFit, best_fit, chosen_sites
from periscopy_sim.scenario import LIFT, Array, Scenario, WallFrame, pixel_edges, rises, wall_frame
from periscopy_sim.shipped import find_scene

RAYS = 256
"""Rays from each of them in a round."""

RAY = 100
"""Time of such a ray, with the paths that go on from what it meets and its shadow rays, over that
of a sample of direct light: measured in a room with windows."""

DIRECT_SAMPLES = 64
"""Samples of each emitter and pixel in a round."""


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
    """

    photograph: Array = field(repr=False)
    relative_error: float
    brightness_error: float


def render_background(
    path: str | Path,
    scenario: Scenario,
    parameters: Mapping[str, str] | None = None,
    *,
    target: float = 3e-4,
    max_rounds: int = 64,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Background:
    """Photograph a scenario's wall in an ambient scene, path traced.

    The ambient scene is moved so that what its own camera sees of its own wall coincides, in
    centre and axes, with what the scenario's camera sees. The wall takes the scenario's
    reflectance; light between it and its surroundings is that of the ambient scene's wall.

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
        Most rounds of samples for each part of the light.
    seed
        Seed of every sampler. The same seed and variant give the same bytes.
    progress
        Called with the fraction done, as estimated.

    Returns
    -------
    Background

    Raises
    ------
    SceneError
        If the ambient scene lacks wall, camera or light or Mitsuba rejects it, its camera does not
        see its wall, no light reaches that, or the scenario's wall is not diffuse.
    VariantError
        In scalar variants.

    Warns
    -----
    RuntimeWarning
        The target was not reached within `max_rounds`.
    """
    require_vectorized("ambient light")
    if scenario.wall_reflectance is None:
        raise SceneError(
            f"scene '{scenario.path}': ambient light needs a diffuse wall; give the wall a BSDF of "
            "type diffuse"
        )
    path = find_scene(path)
    scene, points, normals = placed_in(path, scenario, parameters)
    parts = _parts(scene, points, normals, scenario.photograph_shape)
    seeds = (
        int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
        for number in itertools.count()
    )
    irradiance, errors = refined(parts, target, max_rounds, seeds, progress or (lambda _: None))
    if not irradiance.any():
        raise SceneError(
            f"scene '{path}': no light reaches its wall; move its emitters or its wall"
        )
    error = np.hypot(*errors)
    if error > target:
        warnings.warn(
            f"'{path.stem}' stopped at a relative error of {error:.1e}, above {target:.1e}; "
            "raise max_rounds",
            RuntimeWarning,
            stacklevel=2,
        )
    picture = irradiance * scenario.wall_reflectance / np.pi
    return Background(picture.reshape(*scenario.photograph_shape, 3), *errors)


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
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1):  # the last bits follow the number of threads
            self._sum += np.array([self.estimate(next(seeds)) for _ in range(REPLICAS)])
            self.rounds += 1
            self.fit = best_fit(self._sum / self.rounds, self.sites, self.shape)


def _parts(scene: Any, points: Array, normals: Array, shape: tuple[int, int]) -> list[Part]:
    """Each emitter's direct light at every pixel, and bounced light at a few."""
    edges, sites = pixel_edges(points, normals, shape), chosen_sites(shape)
    direct = [
        partial(direct_irradiance, scene, emitter, points, normals, edges, DIRECT_SAMPLES)
        for emitter in scene.emitters()
    ]
    bounced = BouncedIrradiance(scene, points[sites], normals[sites], RAYS).estimate
    everywhere = np.arange(len(points))
    work = len(points) * DIRECT_SAMPLES, len(sites) * RAYS * RAY
    return [
        *(Part(each, everywhere, shape, work[0]) for each in direct),
        Part(bounced, sites, shape, work[1]),
    ]


def refined(
    parts: list[Part],
    target: float,
    max_rounds: int,
    seeds: Iterator[int],
    progress: Callable[[float], None],
) -> tuple[Array, tuple[float, float]]:
    """Add rounds where they gain most for their time until the whole is as exact as the target.

    Return the irradiance, (M, 3), and its errors, see `relative_errors`.
    """
    for part in parts:
        part.add_round(seeds)
    while True:
        whole = sum((part.fit.replicas for part in parts), np.zeros(()))
        bias = sum((part.fit.squared_bias for part in parts), np.zeros(3))
        mean, errors = whole.mean(axis=0), relative_errors(whole, bias)
        error = np.hypot(*errors)
        open_parts = [part for part in parts if part.rounds < max_rounds]
        if error <= target or not open_parts:
            return mean, errors
        progress(min(1.0, (target / error) ** 2))

        def gain(part: Part, mean: Array = mean) -> float:
            """Return by how much a round lowers the squared error, over its work.

            With the noise the bias falls: more is known of it, and higher powers serve better.
            """
            alone = mean + part.fit.replicas - part.fit.replicas.mean(axis=0)
            error = np.hypot(*relative_errors(alone, part.fit.squared_bias))
            return float(error**2 / (part.rounds + 1) / part.work)

        max(open_parts, key=gain).add_round(seeds)


def relative_errors(replicas: Array, squared_bias: Array) -> tuple[float, float]:
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
    path: Path, scenario: Scenario, parameters: Mapping[str, str] | None
) -> tuple[Any, Array, Array]:
    """Return an ambient scene, and a scenario's wall points and normals, (M, 3), moved into it.

    A SceneError says that it has no light or a medium, or its camera does not see its wall.
    """
    nodes = SceneNodes(path, parameters, required={"wall": "Shape", "camera": "Sensor"})
    check_media(nodes)
    nodes.average_pixels()
    scene = nodes.instantiate()
    if not scene.emitters():
        raise SceneError(f"scene '{path}' has no emitter; give it light")
    view, size = _view_of(scene, path)
    points, normals, shape = scenario.wall_points, scenario.wall_normals, scenario.photograph_shape
    own = wall_frame(points, normals, shape)
    turn = np.stack([own.across, own.normal, own.up]).T @ np.stack(
        [view.across, view.normal, view.up]
    )
    height = np.maximum(LIFT * size, rises(points, normals, shape))
    lifted = points - own.center + height[:, np.newaxis] * normals
    return scene, lifted @ turn + view.center, normals @ turn


def _view_of(scene: Any, path: Path) -> tuple[WallFrame, float]:
    """Centre, axes and size of what the ambient scene's camera sees of its wall."""
    camera, wall = camera_of(scene), shape_of(scene, "wall")

    def meet(film: Any) -> tuple[Any, ...]:
        ray, _ = camera.sample_ray(0.0, 0.0, film, mi.Point2f(0.5, 0.5))
        si = scene.ray_intersect(ray)
        return si.p, si.n * -dr.sign(dr.dot(si.n, ray.d)), si.shape == mi.ShapePtr(wall)

    row, column = np.indices((3, 3)).reshape(2, -1)
    points, normals, seen = map_points(meet, np.stack([column + 0.5, row + 0.5], axis=1) / 3)
    if not seen.all():
        raise SceneError(
            f"scene '{path}': its camera does not see its wall; move what stands between them"
        )
    size = 1.5 * float(np.linalg.norm(np.ptp(points, axis=0)))
    return wall_frame(points, normals, (3, 3)), size
