"""What one photograph shows of the hidden image, in the spectral basis of a scene."""

from dataclasses import dataclass

from periscopy_sim.numerics import Array, Image


@dataclass(frozen=True, eq=False)
class Evidence:
    """The information on the hidden image in one photograph.

    The coefficients are those of y⊥ over its level and A⊥ over a patch's root mean square energy.
    """

    coefficients: Array  # (C, K) WᵀA⊥ᵀ y⊥ of K patterns, in the camera's channels
    noise: Array  # (C,) standard deviation of the noise in y⊥, over the level
    level: float  # root mean square of y⊥
    noise_to_signal: float  # energy of the noise in y⊥ over that of the signal
    rest: Image | None = None  # (C, N) A⊥ᵀ y⊥ beyond K < N patterns

    @property
    def mean_noise(self) -> float:
        """The σ that λ is counted in: the mean over the channels."""
        return float(self.noise.mean())
