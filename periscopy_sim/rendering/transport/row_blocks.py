"""The light transport matrix without the matrix: its rows are rendered whenever they are needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import VariantError
from periscopy_sim.rendering.transport.bounced import BouncedLight
from periscopy_sim.rendering.transport.kernel import Strata, make_kernel
from periscopy_sim.rendering.variant import is_vectorized, use_variant
from periscopy_sim.scenario import Scenario

LANES = 1 << 22
"""Entries of A computed at once; bounds the memory beside A itself (about 40 bytes each)."""

TEXTURE_SAMPLES = 16
"""Least wall points of a pixel where the wall is textured: its grains may be finer than a pixel."""

RAYS = 1 << 28
"""Shadow rays traced at once; bounds the wait for an interrupt, about a second."""


@dataclass(frozen=True, eq=False)
class RenderedTransport:
    """The matrix that `render_transport` gives for the same arguments, a block of rows at a time.

    `reconstruction.large_scale.transport_operator.TransportOperator` makes a SciPy linear operator
    of it, and `IterativePeriscope` takes it in the place of A. Every pass traces all the rays
    again, and draws the same samples.

    Parameters
    ----------
    scenario
        The scene.
    samples, strata, pixel_samples, seed
        As of `render_transport`.
    lanes
        Entries rendered at once; bounds the memory (about 40 bytes each).
    bounced
        What `render_bounced_light` found: the channels' mean of it is added. None: direct light.

    Raises
    ------
    ValueError
        If a number is below 1, or `strata` is not known.
    """

    scenario: Scenario
    samples: int = 16
    strata: Strata = "jittered"
    pixel_samples: int = 1
    seed: int = 0
    lanes: int = LANES
    bounced: BouncedLight | None = None

    def __post_init__(self) -> None:
        if self.samples < 1 or self.pixel_samples < 1 or self.lanes < 1:
            raise ValueError(
                f"{self.samples} samples, {self.pixel_samples} pixel samples, {self.lanes} lanes: "
                "all must be positive"
            )
        if self.strata not in get_args(Strata):
            raise ValueError(f"strata '{self.strata}' are not known; use one of {get_args(Strata)}")

    @property
    def shape(self) -> tuple[int, int]:
        """(M, N)."""
        return self.scenario.transport_shape

    def row_blocks(self) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Yield every row once: a slice of rows and their entries, (rows, N) float32.

        Scalar variants render columns only and raise a `VariantError`.
        """
        use_variant()
        if not is_vectorized():
            raise VariantError(
                "rows of the transport matrix are rendered in llvm_ad_rgb or cuda_ad_rgb only; in "
                "scalar variants store the whole of it: render_transport(..., out=memory_map)"
            )
        import drjit as dr
        import mitsuba as mi

        pixel_samples = self.pixel_samples
        if self.scenario.wall_texture is not None:
            pixel_samples = max(pixel_samples, TEXTURE_SAMPLES)
        entries = make_kernel(self.scenario, self.samples, self.strata, pixel_samples)
        pixels, patches = self.shape
        rays = self.samples * pixel_samples
        height = max(1, min(self.lanes, RAYS // rays) // patches)
        for start in range(0, pixels, height):
            rows = slice(start, min(start + height, pixels))
            lane = dr.arange(mi.UInt32, (rows.stop - start) * patches)
            # Opaque, so that all blocks share one compiled kernel.
            pixel = lane // patches + dr.opaque(mi.UInt32, start)
            values = entries(pixel, lane % patches, dr.opaque(mi.UInt32, self.seed))
            block = np.array(values).reshape(-1, patches)
            yield rows, block if self.bounced is None else block + self.bounced.rows(rows)
