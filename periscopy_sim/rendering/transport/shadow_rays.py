"""The light transport matrix A of any Mitsuba scene.

Column j of A is the photograph of the wall when only patch j shines with unit normal radiance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, overload

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.transport.bounced import check_bouncing_wall
from periscopy_sim.rendering.transport.bounced_transport import BouncedTransport, add_bounces
from periscopy_sim.rendering.transport.bounces import DIRECT, check_bounces
from periscopy_sim.rendering.transport.kernel import Strata
from periscopy_sim.rendering.transport.row_blocks import LANES, RenderedTransport
from periscopy_sim.rendering.variant import is_vectorized, use_variant
from periscopy_sim.scenario import Scenario

Progress = Callable[[float], None]


DIRECT_SHARE = 0.1
"""Of the time that a matrix with bounced light takes, about, up to which direct light is done."""


@overload
def render_transport(
    scenario: Scenario,
    *,
    samples: int = ...,
    strata: Strata = ...,
    pixel_samples: int = ...,
    bounces: Literal[1] = ...,
    seed: int = ...,
    out: NDArray[np.float32] | None = ...,
    progress: Progress | None = ...,
) -> NDArray[np.float32]: ...


@overload
def render_transport(
    scenario: Scenario,
    *,
    samples: int = ...,
    strata: Strata = ...,
    pixel_samples: int = ...,
    bounces: int | None,
    seed: int = ...,
    out: NDArray[np.float32] | None = ...,
    progress: Progress | None = ...,
) -> NDArray[np.float32] | BouncedTransport: ...


def render_transport(
    scenario: Scenario,
    *,
    samples: int = 16,
    strata: Strata = "jittered",
    pixel_samples: int = 1,
    bounces: int | None = DIRECT,
    seed: int = 0,
    out: NDArray[np.float32] | None = None,
    progress: Progress | None = None,
) -> NDArray[np.float32] | BouncedTransport:
    """Render the light transport matrix by shadow rays, and light that bounces by paths.

    Each patch is cut into as many strata as samples; one shadow ray goes from the wall point to
    each. Through a thin lens each sample sees a wall point of its own, spread over the aperture. In
    scalar variants, where this would crawl, Mitsuba's own direct integrator renders the columns one
    by one with as many samples a pixel (always jittered, over the pixel's whole area).

    A pixel is its centre, or with more `pixel_samples` the mean over its area; the film's own
    reconstruction filter is not used.

    Parameters
    ----------
    scenario
        The scene.
    samples
        Samples of a patch for each wall point.
    strata
        Where in its stratum a sample lies: ``"jittered"`` (unbiased; noise of independent entries),
        or, without noise but with penumbrae in steps, ``"midpoint"`` or ``"gauss"``: Gauss and
        Legendre's two points of each pair of strata along an axis, exact for cubic integrands; of
        an odd number the middles.
    pixel_samples
        Wall points of a pixel: 1 is its centre; more are spread over its area in strata and
        averaged. A textured wall has at least `TEXTURE_SAMPLES`.
    bounces
        Most reflections of the monitor's light on its way to the camera: 1 is the wall's alone,
        direct light; None is any number, as light has it. What bounces is smooth over the wall and
        estimated apart, see `BouncedLight`.
    seed
        Seed of the jitter, and of paths. The same seed and variant give the same bytes.
    out
        (M, N) array to fill, such as a memory map; None allocates one.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray or BouncedTransport
        A, (M, N) float32, radiance sent to the camera for each unit of a patch's normal radiance.
        Multiplied by the channel's `Scenario.channel_gain` where the wall is coloured. With more
        than one bounce the matrices of all channels, which coloured surroundings make differ.

    Raises
    ------
    SceneError
        If no light of the monitor reaches the wall, or what bounces is not known of such a wall
        (see `render_bounced_light`).
    ValueError
        If a number of samples or bounces is below 1, `strata` is none of these, or `out` has
        another shape.

    Warns
    -----
    RuntimeWarning
        Bounced light is not known well enough, see `render_bounced_light`.
    """
    use_variant()
    alone = check_bounces(bounces) == DIRECT
    if not alone:
        check_bouncing_wall(scenario)
    rendered = RenderedTransport(scenario, samples, strata, pixel_samples, seed, LANES)
    A = np.empty(rendered.shape, np.float32) if out is None else out
    if A.shape != rendered.shape:
        raise ValueError(f"out has shape {A.shape}, the transport matrix {rendered.shape}")
    report = progress or (lambda _: None)
    share = 1.0 if alone else DIRECT_SHARE
    if not is_vectorized():
        from periscopy_sim.rendering.transport.scalar import render_columns

        render_columns(
            scenario, A, samples=samples, seed=seed, progress=lambda done: report(share * done)
        )
    else:
        for rows, block in rendered.row_blocks():
            A[rows] = block
            report(share * rows.stop / len(A))
    require_light(A, scenario)
    if alone:
        return A
    return add_bounces(
        scenario, A, bounces, seed=seed, progress=lambda done: report(share + (1 - share) * done)
    )


def require_light(A: NDArray[np.float32], scenario: Scenario) -> None:
    """Check that a transport matrix is not all black; else raise a SceneError."""
    if not A.any():
        raise SceneError(
            f"scene '{scenario.path}': no light of the monitor reaches the wall; look for what "
            "stands between them, or an emitter that shines in other directions"
        )
