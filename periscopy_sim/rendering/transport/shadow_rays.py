"""The light transport matrix A of any Mitsuba scene, whole or a block of rows at a time.

Column j of A is the photograph of the wall when only patch j shines with unit normal radiance.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.geometry import Geometry
from periscopy_sim.hidden import Hidden
from periscopy_sim.numerics.limits import checked
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.rendering.transport.kernel import Kernel, Strata
from periscopy_sim.rendering.variant import LANES, dr, mi, require_vectorized


def render_transport(
    scenario: Geometry,
    *,
    samples: int = 16,
    strata: Strata = "jittered",
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.float32]:
    """Render the light transport matrix of direct light by shadow rays.

    Each patch is cut into as many strata as samples; one shadow ray goes from the wall point to
    each. Light that bounces is added by `add_bounces`.

    A pixel is its centre, or the mean over the points of `Geometry.averaged`; the film's own
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
    seed
        Seed of the jitter. The same seed and variant give the same bytes.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray
        A, (M, N) float32, radiance sent to the camera for each unit of a patch's normal radiance.
        Multiplied by the channel's `Geometry.channel_gain` where the wall is coloured.

    Raises
    ------
    SceneError
        If no light of the monitor reaches the wall.
    VariantError
        In scalar variants.
    """
    rendered = RenderedTransport(scenario, samples, strata, seed)
    A = np.empty(rendered.shape, np.float32)
    for rows, block in rendered.row_blocks():
        A[rows] = block
        if progress is not None:
            progress(rows.stop / len(A))
    require_light(A, scenario)
    return A


def require_light(A: NDArray[np.float32], scenario: Geometry) -> None:
    """Check that every hidden surface lights a pixel beyond rounding; else raise a SceneError."""
    least = float(np.finfo(A.dtype).eps) * A.max(initial=0)
    for name, part in scenario.hidden.slices.items():
        if not A[:, part].max(initial=0) > least:
            raise SceneError(
                f"scene '{scenario.path}': no light of '{name}' reaches the wall; look for what "
                "stands between them, or an emitter that shines in other directions"
            )


@dataclass(frozen=True, eq=False)
class RenderedTransport:
    """The matrix that `render_transport` gives for the same arguments, a block of rows at a time.

    `model.transport_operator.TransportOperator` makes a SciPy linear operator of it, for solvers
    that pass over A. Every pass traces all the rays again, and draws the same samples. Parameters
    that `render_transport` rejects are a ValueError.
    """

    scenario: Geometry
    samples: int = 16
    strata: Strata = "jittered"
    seed: int = 0

    def __post_init__(self) -> None:
        checked("samples", self.samples, "rays")
        if self.strata not in get_args(Strata):
            raise ValueError(f"strata '{self.strata}' are not known; use one of {get_args(Strata)}")
        hidden, scene = self.scenario.hidden, self.scenario.scene
        traced = Hidden.of_scene(scene, hidden.shapes)
        if not np.allclose(traced.centers, hidden.centers, rtol=1e-4, atol=1e-6):
            raise InputError(
                f"rays meet the hidden surfaces where scene '{scene.path}' has them, not where the "
                "given ones are; move them in the scene, or compute A by areas"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(M, N)."""
        return self.scenario.transport_shape

    def row_blocks(
        self, pixels: NDArray[np.integer[Any]] | None = None
    ) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Yield every row, or those of some pixels, once: a slice and its (rows, N) entries.

        Scalar variants raise a `VariantError`.
        """
        require_vectorized("the transport matrix by rays")
        hidden = self.scenario.hidden
        kernels = [Kernel(self.scenario, name, self.samples, self.strata) for name in hidden]
        chosen = np.arange(self.shape[0]) if pixels is None else pixels
        numbers = mi.UInt32(self.scenario.view.numbers[chosen].astype(np.uint32))
        work = max(1, self.samples * self.scenario.view.across**2 // RenderedTransport.samples)
        height = max(1, LANES // work // hidden.patches)
        for start in range(0, len(chosen), height):
            rows = slice(start, min(start + height, len(chosen)))
            # Opaque, so that all blocks share one compiled kernel.
            first, parts = dr.opaque(mi.UInt32, start), []
            for k, (entries, surface) in enumerate(zip(kernels, hidden.values(), strict=True)):
                patches = len(surface.centers)
                lane = dr.arange(mi.UInt32, (rows.stop - start) * patches)
                pixel = dr.gather(mi.UInt32, numbers, lane // patches + first)
                values = entries(pixel, lane % patches, dr.opaque(mi.UInt32, self.seed + k))
                parts.append(np.array(values).reshape(-1, patches))
            yield rows, np.hstack(parts) if len(parts) > 1 else parts[0]

    def white(self, pixels: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Return the light, (K,), that a white hidden image sends to some pixels."""
        blocks = self.row_blocks(pixels)
        return np.concatenate([block.sum(axis=1, dtype=np.float64) for _, block in blocks])
