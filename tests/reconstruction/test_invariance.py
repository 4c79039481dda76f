"""Images do not depend on how a photograph, A and B are written down."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from periscopy_sim.reconstruction.large_scale.iterative import IterativePeriscope
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
from periscopy_sim.reconstruction.preconditioned.still import Periscope
from periscopy_sim.reconstruction.registry import METHODS as ENTRIES

SHAPE, HIDDEN = (14, 15), (4, 5)
M, N = 210, 20
RNG = np.random.default_rng(4)
V, U = (axis.ravel() for axis in np.meshgrid(*(np.linspace(-1, 1, n) for n in SHAPE)))
PATTERNS = [np.linalg.qr(RNG.standard_normal((size, N)))[0] for size in (M, N)]
A = (PATTERNS[0] * np.geomspace(1, 3e-2, N)) @ PATTERNS[1].T + 0.5
B = np.stack([np.ones(M), U, V], axis=1)
TRUTH = RNG.uniform(0.2, 1, (N, 3))
Y = A @ TRUTH + B @ np.array([[9], [1], [2]]) + 3e-3 * RNG.standard_normal((M, 3))
SCENE = SimpleNamespace(photograph_shape=SHAPE, hidden=HIDDEN, channel_gain=np.ones(3))
METHODS = [NoiseAware, Periscope, IterativePeriscope]
TOLERANCE = 3e-4
"""Relative, of an image: ten times what single precision makes of these A."""


@dataclass(frozen=True)
class Writing:
    """One of many ways to write the same photograph, A and B down."""

    channels: list[int]
    pixels: list[int]
    columns: list[int]
    light: float  # unit of the photograph
    transport: float  # unit of A
    ambient: float  # unit of B
    dtype: str
    order: str

    def image_by(self, kind):
        """Return the image, (N, 3), in the units and the order of the original."""
        y = self.light * Y[self.pixels][:, self.channels]
        y = np.array(y.reshape(*SHAPE, 3), self.dtype, order=self.order)
        method = kind(
            np.array(self.transport * A[self.pixels], order=self.order),
            self.ambient * B[self.pixels][:, self.columns],
            hidden=HIDDEN,
        )
        image = method.reconstruct(y).reshape(N, 3) * self.transport / self.light
        return image[:, np.argsort(self.channels)]


PLAIN = Writing([0, 1, 2], list(range(M)), [0, 1, 2], 1.0, 1.0, 1.0, "f8", "C")
UNITS = st.sampled_from([1e-12, 0.3, 1.0, 1e12])
WRITINGS = st.builds(
    Writing,
    channels=st.permutations(range(3)),
    pixels=st.permutations(range(M)),
    columns=st.permutations(range(3)),
    light=UNITS,
    transport=st.sampled_from([1e-6, 0.3, 1.0, 1e12]),
    ambient=UNITS,
    dtype=st.sampled_from(["f8", ">f8", "f4", ">f4", "longdouble"]),
    order=st.sampled_from("CF"),
)


@pytest.mark.parametrize("name", [name for name, entry in ENTRIES.items() if not entry.needs])
@pytest.mark.parametrize("value", [0.0, 5.0])
def test_a_constant_channel_disturbs_no_other(name, value):
    """Not by more than the coupling of edges; its own image is finite."""
    repairs = any(option.name == "repair_threshold" for option in ENTRIES[name].options)
    # The threshold of repairs is one for all channels.
    method = ENTRIES[name](SCENE, A, B, **({"repair_threshold": 1e9} if repairs else {}))
    y = Y.reshape(*SHAPE, 3).copy()
    expected = method.reconstruct(y)
    y[..., 2] = value
    image = method.reconstruct(y)
    assert np.isfinite(image).all()
    error = np.linalg.norm((image - expected)[..., :2]) / np.linalg.norm(expected[..., :2])
    assert error < 0.05


@pytest.mark.parametrize("kind", METHODS)
@settings(max_examples=6, deadline=None, phases=[Phase.generate])
@given(writing=WRITINGS)
def test_units_orders_and_types_do_not_matter(kind, writing):
    expected = PLAIN.image_by(kind)
    error = np.linalg.norm(writing.image_by(kind) - expected) / np.linalg.norm(expected)
    assert error < TOLERANCE
