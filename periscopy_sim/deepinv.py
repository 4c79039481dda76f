"""The light transport as physics of deepinv, with the package's noise and ambient light.

    y = P (A f + s b + n) / norm,   mean(A f) = SBR mean(s b),   n ~ N(0, σ²),
    σ = 10^(−SNR/20) times the root mean square of A f + s b

P projects backgrounds out, where some are given. The operator P A / norm has norm 1, since the
tolerances of deepinv are absolute: in physical units, of norm 0.01 or so, its solvers stop early.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.adapters import TorchTransport
from periscopy_sim.errors import require
from periscopy_sim.model.fit import Fit
from periscopy_sim.numerics import Image, validation

torch = require("torch")
if TYPE_CHECKING:
    from deepinv import physics
else:
    physics = require("deepinv").physics


class Measurement(physics.NoiseModel):  # type: ignore[misc]  # deepinv has no types
    """Ambient light at an SBR, then white Gaussian noise at an SNR, each photograph by its own."""

    def __init__(self, snr: float | None, ambient: Any, sbr: float, rng: Any) -> None:
        super().__init__(rng=rng)
        self.snr, self.sbr = snr, sbr
        self.register_buffer("ambient", ambient, persistent=False)

    def forward(self, y: Any, seed: int | None = None) -> Any:
        """Return (B, C, r, c) photographs with ambient light and noise."""
        self.rng_manual_seed(seed)
        each = (-3, -2, -1)
        if self.ambient is not None:
            y = y + self.ambient * (y.mean(each, keepdim=True) / (self.ambient.mean() * self.sbr))
        if self.snr is None:
            return y
        σ = 10 ** (-self.snr / 20) * y.square().mean(each, keepdim=True).sqrt()
        return y + σ * self.randn_like(y)


class Periscopy(physics.LinearPhysics):  # type: ignore[misc]  # deepinv has no types
    """The wall's photograph of a hidden image, (B, C, R, C') to (B, C, r, c), of operator norm 1.

    Divide a photograph that was not made here by `norm` and project its backgrounds out:
    ``physics.reject_backgrounds(photograph / physics.norm)``.

    Parameters
    ----------
    transport
        A scene, whose A is rendered; or A, (M, N) of float32 or float64.
    scene
        As of `transport_operator`.
    snr
        Signal-to-noise ratio of a photograph in dB, as of `add_noise`; None for no noise.
    ambient
        (r, c, C) ambient light in any unit, as `render_background` gives it; None for none.
    sbr
        mean(signal) / mean(ambient light), as of `composite`.
    backgrounds
        (M, K) columns to project out of every photograph, such as `point_light_backgrounds`; None
        for none.
    seed
        Seed of the noise.
    device
        Where A is kept.

    Attributes
    ----------
    norm
        Operator norm of A in physical units, backgrounds projected out.
    """

    def __init__(
        self,
        transport: Any,
        scene: Any = None,
        *,
        snr: float | None = 60.0,
        ambient: Image | None = None,
        sbr: float = 0.5,
        backgrounds: Image | None = None,
        seed: int = 0,
        device: Any = "cpu",
    ) -> None:
        validation.checked("snr", [] if snr is None else snr, "decibels")
        validation.checked("sbr", sbr, "ratio")
        light = TorchTransport(transport, scene)
        b, shape = None, (*light.photograph_shape, len(light.gain))
        if ambient is not None:
            ambient = np.asarray(ambient)
            if ambient.shape != shape or not np.mean(ambient) > 0:
                raise ValueError(f"ambient light is {shape}, of a positive mean")
            b = torch.as_tensor(np.moveaxis(ambient, -1, 0).copy()).to(light.A)
        rng = torch.Generator(device).manual_seed(seed)
        super().__init__(
            img_size=(len(light.gain), *light.hidden.shape),
            noise_model=Measurement(snr, b, sbr, rng),
            sensor_model=self.reject_backgrounds,
        )
        fit = Fit(light.A.numpy(), backgrounds, hidden=light.hidden)
        Q = None if backgrounds is None else torch.as_tensor(fit.basis).to(light.A)
        strongest = np.linalg.eigvalsh(fit.operator.gram)[-1]
        self.norm = float(np.sqrt(strongest)) * float(light.gain.max())
        self._patches, self._pixels = light.hidden.shape, light.photograph_shape
        self.register_buffer("_A", light.A / self.norm, persistent=False)
        self.register_buffer("_gain", light.gain, persistent=False)
        self.register_buffer("_Q", Q, persistent=False)
        self.to(device)

    def forward(self, x: Any, **parameters: Any) -> Any:
        """Return the photographs of hidden images as measured, then backgrounds projected out.

        SBR and SNR are those of the photograph before the projection.
        """
        self.update(**parameters)
        return self.sensor(self.noise(self._photographs(x), **parameters))

    def A(self, x: Any, **_: Any) -> Any:  # noqa: N802
        """Return the photographs of hidden images, backgrounds projected out, without noise."""
        return self.reject_backgrounds(self._photographs(x))

    def A_adjoint(self, y: Any, **_: Any) -> Any:  # noqa: N802
        """Return the adjoint's hidden images of photographs."""
        light = self.reject_backgrounds(y).flatten(-2) * self._gain
        return (light @ self._A).unflatten(-1, self._patches)

    def reject_backgrounds(self, y: Any) -> Any:
        """Project the backgrounds out of photographs."""
        if self._Q is None:
            return y
        planes = y.flatten(-2)
        return (planes - (planes @ self._Q) @ self._Q.T).reshape(y.shape)

    def _photographs(self, x: Any) -> Any:
        """Return the photographs, (B, C, r, c), of hidden images, (B, C, R, C')."""
        return (self._gain * (x.flatten(-2) @ self._A.T)).unflatten(-1, self._pixels)
