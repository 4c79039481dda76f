"""How A is made: by areas where the scene has them, else by as many rays as the noise asks for.

Whatever fits a photograph to A takes the error of A for light. By areas it errs where light changes
within a pixel, which more wall points in a pixel mend; rays leave noise of their own, too. Two
computations of a few rows measure either.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.area_transport import area_transport, has_areas, points_across, ways_to
from periscopy_sim.errors import ClosedFormError, SceneError
from periscopy_sim.hidden import Hidden
from periscopy_sim.measurement import OWN_SHARE
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.validation import InputError, checked, checked_number, checked_scene
from periscopy_sim.rendering.bounced import DIRECT, BouncedTransport, add_bounces
from periscopy_sim.rendering.shadow_rays import RenderedTransport, render_transport, require_light
from periscopy_sim.view import Geometry, View

By = Literal["areas", "rays"]

NOISE = 1e-3
"""Noise of a photograph over its mean where none is known: 60 dB, the paper's."""

SMALL = 1 / 10
"""Error of A over the noise that counts as small. An image of 29 x 36 patches loses 0.1 dB by it,
0.4 to 0.6 by a third of the noise (chair and plate, 60 dB, A by areas of 126 x 126 pixels)."""

ROUNDING = 1e-6
"""Error over its mean of light by areas on any grid: 8e-7 (chair and plate, beside `CELLS` of 36)
where entries of A err by 6e-6; single precision adds 2e-8."""

FEWEST = 4
"""Rays from each wall point to each patch to begin with."""

BUDGET = 1 << 30
"""Most rays for a whole A: 3 s of two cores for the chair, a minute for a hidden mesh. By them the
shipped scenes err by 0.11 to 0.40 times the noise of 60 dB, at 29 x 36 patches."""

PIXELS = 64
"""Draws of pixels whose rows measure the error of A: to 9 % by rays, which err alike everywhere."""

MOST_POINTS = 1 << 20
"""Wall points at which the error of A by areas is measured: 0.1 GB."""

ROUGH = 12
"""Rows and columns of patches, at most, of a curved surface whose white light a plan looks at."""

FINEST = 4
"""Times as many wall points along each side of a pixel, at most, as `points_across`, by areas."""


@dataclass(frozen=True)
class TransportPlan:
    """How a scene's A is made, and how large its own error is."""

    error: float  # standard deviation of a white image's light in A, over its mean; NaN: unknown
    samples: int | None = None  # rays from each wall point to each patch; None for A by areas
    across: int = 1  # wall points along each side of a pixel, that A is averaged over
    is_given: bool = False  # whether A is a user's own
    made: NDArray[np.float32] | None = field(default=None, compare=False, repr=False)
    """A, if choosing the plan took all of it"""

    @property
    def by(self) -> str:
        """The way to A: ``areas``, ``rays``, or ``file`` of a user's own."""
        return "file" if self.is_given else "areas" if self.samples is None else "rays"

    @property
    def origin(self) -> dict[str, Any]:
        """The entries of a record on how A was made."""
        return {
            "model": {"areas": "analytic", "rays": "rendered"}.get(self.by, self.by),
            "samples": self.samples,
            "pixel_samples": self.across**2,
            "transport_error": None if np.isnan(self.error) else self.error,
        }

    def transport(self, scenario: Geometry, **of_rays: Any) -> NDArray[np.float32]:
        """Compute A of direct light, (M, N), unless the plan has it.

        `render_transport` has the keywords, for rays. A SceneError says that no light of the
        monitor reaches the wall.
        """
        scenario = scenario.averaged(self.across)
        if self.samples is not None:
            return render_transport(scenario, samples=self.samples, **of_rays)
        A = area_transport(scenario) if self.made is None else self.made
        require_light(A, scenario)
        return A


def planned(
    scenario: Geometry,
    noise: float = NOISE,
    *,
    by: By | None = None,
    samples: int | None = None,
    seed: int = 0,
) -> TransportPlan:
    """Choose how A is made for photographs of some noise, over the mean of the monitor's light.

    A is averaged over the pixels' areas by as many wall points, and as many rays, as make its error
    a tenth of the noise or less, within `FINEST` and `BUDGET`. The plan's error exceeds a tenth
    where these are too few. `samples` asks for so many rays from the centre of each pixel to each
    patch. An infinite noise takes the quickest way, of unknown error. Errors and other parameters
    are those of `transport`; the seed is of the rays that measure the error.
    """
    checked_scene(scenario)
    if by not in (None, *get_args(By)):
        raise InputError(f"by is {by!r}: give one of {', '.join(get_args(By))}, or None")
    noise = max(checked_number(noise, "noise", 0, np.inf), ROUNDING / SMALL)
    checked("seed", seed, "seed")
    if by == "areas":
        ways_to(scenario)
    if noise == np.inf:
        is_closed = by == "areas" or (by is None and samples is None and has_areas(scenario))
        return TransportPlan(np.nan, None if is_closed else samples or FEWEST)
    across = max(scenario.view.across, points_across(scenario.photograph_shape))
    if by == "areas" or (by is None and samples is None and has_areas(scenario)):
        try:
            return _plan_areas(scenario, across, noise)
        except ClosedFormError:  # on a finer grid
            if by == "areas":
                raise
    if samples is not None:
        return TransportPlan(transport_error(scenario, samples, seed=seed), samples)
    samples, rays = FEWEST, across**2 * int(np.prod(scenario.transport_shape))
    most = BUDGET / rays
    while (error := transport_error(scenario, samples, across, seed=seed)) > SMALL * noise:
        # The error falls as samples^-0.75 at edges of shadows, as samples^-1 where light is smooth.
        wanted = samples * max(2.0, error / (SMALL * noise))
        samples, fewer = 2 ** int(np.log2(max(min(2 * wanted - 1, most), samples))), samples
        if samples == fewer:
            break
    return TransportPlan(error, samples, across)


def _plan_areas(scenario: Geometry, across: int, noise: float) -> TransportPlan:
    """Return the fewest wall points in a pixel by which A by areas errs little.

    A of twice the points along each side errs by a fourth, or a third at edges of shadows. Pixels
    are drawn as often as light bends there, and weighted for that: few may hold all of the error.
    """

    def white(across: int, hidden: Hidden = scenario.hidden) -> Array:
        """Return a white image's light in the drawn rows."""
        view = scenario.averaged(across).view
        used = np.isin(np.arange(np.prod(view.shape)), view.numbers[rows])
        some = Geometry(view.of_pixels(used.reshape(view.shape)), hidden)
        return np.asarray(area_transport(some).sum(axis=1, dtype=np.float64))

    shapes = scenario.hidden.shapes
    few = {name: (min(R, ROUGH), min(C, ROUGH)) for name, (R, C) in shapes.items()}
    is_curved = any(surface.curved is not None for surface in scenario.hidden.values())
    # Where white light bends, large patches show as well as small ones.
    rough = Hidden.of_scene(scenario.scene, few) if is_curved else scenario.hidden
    first, most = across, FINEST * across
    A = area_transport(Geometry(scenario.averaged(across).view, rough))
    light = A.sum(axis=1, dtype=np.float64)
    mean = float(light.mean()) or 1.0
    bends = _bends(light / scenario.view.paint[:, 0], scenario.view)
    chances = (1 + bends / (bends.mean() or 1.0)) / 2 / len(light)
    chances /= chances.sum()
    drawn = np.random.default_rng(0).choice(len(light), 4 * PIXELS, p=chances)
    rows, places = np.unique(drawn, return_inverse=True)

    def deviation(squares: Array) -> float:
        """Return the root mean square over all pixels of what the drawn rows sample."""
        return float(np.sqrt((squares[places] / (len(light) * chances[drawn])).mean())) / mean

    coarse, bent = light[rows], 0.0
    if is_curved:
        coarse = white(across)
        # A curved patch counts as flat where it is cut; a quarter of it errs by a fourth.
        halves = {name: (2 * R, 2 * C) for name, (R, C) in shapes.items()}
        whole, halved = (
            white(across, Hidden.of_scene(scenario.scene, sizes)) for sizes in (shapes, halves)
        )
        bent = deviation((whole - halved) ** 2)
    while True:
        # A parabola's mean over a pixel is off its middle by its second difference over 24.
        error = float(np.sqrt(np.mean(bends**2))) / (24 * across**2 * mean)
        if len(light) * 4 * across**2 > MOST_POINTS:
            break
        try:
            fine = white(2 * across)
        except SceneError:  # a pixel's edge misses the wall
            break
        error = deviation((fine - coarse) ** 2)
        if error <= SMALL * noise or 2 * across > most:
            break
        across, coarse = 2 * across, fine
    made = None if is_curved or across > first else A
    return TransportPlan(max(float(np.hypot(error, bent)), ROUNDING), None, across, made=made)


def _bends(light: Array, view: View) -> Array:
    """Return the second differences of light, (M,), down and across the photograph, added."""
    if view.pixels is not None:
        return np.zeros_like(light)
    image = np.pad(light.reshape(view.shape), 1, mode="edge")
    down, along = (np.abs(np.diff(image, 2, axis=axis)) for axis in (0, 1))
    return np.asarray((down[:, 1:-1] + along[1:-1]).ravel())


def transport_error(scenario: Geometry, samples: int, across: int = 1, *, seed: int = 0) -> float:
    """Measure the error of an A by rays: the root mean square over a white image's mean light.

    Rows of `PIXELS` pixels are compared with others by independent rays, averaged over the pixels'
    areas. With as many wall points both err alike; rows of pixels' centres also by light's
    curvature.
    """
    rows = np.random.default_rng(seed).permutation(scenario.transport_shape[0])[:PIXELS]
    rows.sort()
    most = max(across, points_across(scenario.photograph_shape))
    first, second = (
        RenderedTransport(scenario.averaged(each), samples, "jittered", seed + shift).white(rows)
        for shift, each in enumerate((across, most), 1)
    )
    variance = np.mean((first - second) ** 2) / (1 + (across / most) ** 2)
    light = float(np.mean(second))
    return float(np.sqrt(variance)) / light if light > 0 else 0.0


def planned_for(
    images: Array,
    scenario: Geometry,
    noise: float,
    *,
    by: By | None = None,
    samples: int | None = None,
    seed: int = 0,
) -> tuple[float, NDArray[np.float32]]:
    """Return A, as fine as images' light, (K, N, C), needs, too, and the largest error of that.

    The error is over the mean of an image's light, at 4 `PIXELS` pixels against rows of more wall
    points or, by rays, as many others; it is a tenth of the noise at most, within the budgets.
    Where these rows miss the wall it is the plan's.
    Light of small bright details errs up to 8 times as much as white light (chair and plate).
    """
    plan = planned(scenario, noise, by=by, samples=samples, seed=seed)
    rows = np.random.default_rng(seed).permutation(scenario.transport_shape[0])[: 4 * PIXELS]
    rows.sort()
    first = points_across(scenario.photograph_shape)
    while True:
        A = plan.transport(scenario, seed=seed)
        try:
            view = scenario.averaged(max(2 * plan.across, first)).view
        except SceneError:  # a pixel's edge misses the wall
            return plan.error, A
        used = np.isin(np.arange(np.prod(view.shape)), view.numbers[rows])
        some = Geometry(view.of_pixels(used.reshape(view.shape)), scenario.hidden)
        some_rows = replace(plan, across=view.across, made=None)
        light = some_rows.transport(some, seed=seed + 1) @ images
        off = np.sqrt(np.mean((A[rows] @ images - light) ** 2, axis=(1, 2)))
        error = float((off / (light.mean(axis=(1, 2)) + 1e-30)).max())
        finer = replace(plan, across=2 * plan.across, made=None)
        if plan.samples is not None:
            finer = replace(plan, samples=4 * plan.samples)
        rays = (finer.samples or 0) * finer.across**2 * int(np.prod(scenario.transport_shape))
        if samples or error <= SMALL * noise or finer.across > FINEST * first or rays > BUDGET:
            return error, A
        plan = finer


def transport(
    seen: Geometry | View,
    hidden: Hidden | None = None,
    *,
    by: By | None = None,
    bounces: int | None = DIRECT,
    noise: float = NOISE,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float32] | BouncedTransport:
    """Compute the light transport matrix A, by areas where the scene has them, else by rays.

    Parameters
    ----------
    seen
        A scenario, or what a camera sees of the wall.
    hidden
        The hidden surfaces in patches, beside a view.
    by
        ``"areas"``, the closed form of `analytic_transport`, or
        ``"rays"``, see `render_transport`; None takes areas where the scene has them.
    bounces
        Most reflections of a path: 1 is direct light, None any number; see `add_bounces`.
    noise
        Noise of the photographs that A serves, over their mean: A is averaged over so many points
        of each pixel, by so many rays, that its error is below a tenth of it, within a budget.
    seed
        Seed of the rays.
    progress
        Called with the fraction of the rays done.

    Returns
    -------
    ndarray or BouncedTransport
        A, (M, N) float32; with bounces, the matrices of all channels.

    Raises
    ------
    SceneError
        If no light of the monitor reaches the wall, or areas are asked for and the scene has none.
    VariantError
        If rays are needed in a scalar variant.
    """
    if bounces is not None:
        checked("bounces", bounces, "bounces")
    if isinstance(seen, View) and hidden is not None:
        seen, hidden = Geometry(seen, hidden), None
    if hidden is not None or not isinstance(seen, Geometry):
        raise InputError(
            f"the scene is of type {type(seen).__name__}: give a scenario, which ps.load_scenario "
            "returns, or a view and the hidden surfaces beside it"
        )
    plan = planned(seen, noise, by=by, seed=seed)
    if plan.error > OWN_SHARE * noise:
        remedy = "the camera or the hidden image fewer pixels"
        if plan.by == "areas":
            remedy = "the camera more pixels, or curved surfaces more patches"
        warnings.warn(
            f"A by {plan.by} errs by {plan.error:.2g} of its mean, more than a third of the "
            f"noise of {noise:.2g}; give {remedy}",
            RuntimeWarning,
            stacklevel=2,
        )
    A = plan.transport(seen, seed=seed, progress=progress)
    return A if bounces == DIRECT else add_bounces(seen, A, bounces, seed=seed)
