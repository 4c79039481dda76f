"""Whether a photograph taken for one with the monitor off still shows the monitor.

What smooth light leaves of it is paint, noise, shadows of lamps; or light of the monitor, which an
image f ≥ 0 then explains by A. So do images by chance, the more the smoother paint or shadows are;
but they explain as much of the photograph turned upside down, left to right, or both, where the
monitor's light does not fit. Of what the best of these leaves, the part that the photograph as it
stands explains beyond is compared with `MOST`.

Measured on 13 photographs with the monitor off (chair and lamp; paint of up to 0.8 % in grains of 1
to 12 pixels, bars of light, the occluder's shadow as other lamps cast it): at most 0.05. On four
path-traced laboratories (lamp, shelf with lamps nearby, bottle, plate), of the true scene and of
one off by a centimetre, paint of 0.4 and 0.8 %, 16 photographs for each brightness of the monitor:

    monitor over ambient light   1             1/3           1/10            0
    part, three laboratories     0.47 to 0.84  0.23 to 0.60  0.04 to 0.29   -0.02 to 0.02
    part, the plate              0.09 to 0.18  0.04 to 0.11  0.01 to 0.03   -0.01
    above `MOST`                 12 of 16      10 of 16      2 of 16         0 of 16

The plate's shadows look much the same turned: there a monitor left on is not seen. The same number
doubts a photograph whose monitor should be on, from `LEAST` down.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from periscopy_sim.reconstruction.large_scale.transport_operator import (
    Matrix,
    row_blocks,
    used_rows,
)
from periscopy_sim.reconstruction.observation import Observation
from periscopy_sim.reconstruction.residual.orientations import FLIPPED

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

MOST = 0.25
"""Part that an image may explain of a background photograph, beyond what it explains turned."""

LEAST = 0.03
"""Part that it must explain of a photograph whose monitor is on."""

COARSE = 12
"""Patches along the longer side of the images tried: a monitor's light shows in these, too."""

ROWS = 1024
"""Rows of A that are summed at once."""


def check_monitor_off(A: Matrix, smooth: Array, observation: Observation) -> None:
    """Refuse background photographs that still show the monitor; a ValueError names the first.

    A is (M, N), the smooth light an orthonormal basis of range(B), (M', r). Where the photographs'
    rows and columns are not known, they cannot be turned, and nothing is refused.
    """
    shares = shares_of_images(A, smooth, observation)
    if shares is None:
        return
    for name, planes in observation.backgrounds.items():
        if shares(planes) > MOST:
            raise ValueError(
                f"{name}: still shows the monitor, which was on, or is the photograph itself; "
                "switch the monitor off, or cover it, and take it again"
            )


def monitor_doubt(A: Matrix, smooth: Array, observation: Observation, photograph: Image) -> str:
    """Return why a photograph, (rows, columns, 3), may show no monitor; empty where it does.

    It is one whose paint, or light that is not smooth, is taken for a hidden image: see the module.
    Arguments are those of `check_monitor_off`; where that refuses nothing, nothing is doubted.
    """
    shares = shares_of_images(A, smooth, observation)
    (planes,) = observation.planar(np.asarray(photograph)[None])
    if shares is None or shares(planes) > LEAST:
        return ""
    return (
        "the photograph hardly shows a hidden image: an image explains as much of it turned upside "
        "down or left to right; is the monitor on, and does the occluder stand where the scene "
        "has it?"
    )


def shares_of_images(
    A: Matrix, smooth: Array, observation: Observation
) -> Callable[[Array], float] | None:
    """Return what gives the part of a photograph's (3, M') planes that an image explains.

    It is a part of what light of no monitor explains of them, beyond what an image explains of them
    turned. None where rows and columns are not known, or no smooth light is.
    """
    if observation.rows_and_columns is None or not smooth.shape[1]:
        return None
    transport = coarse_transport(A, observation)
    transport -= smooth @ (smooth.T @ transport)
    basis, R = np.linalg.qr(transport)

    def explained(planes: Array) -> float:
        """Return the part of what smooth light leaves that an image explains."""
        rest = planes - (planes @ smooth) @ smooth.T
        energy = sum(float(z @ z) - nnls(R, z)[1] ** 2 for z in rest @ basis)
        return float(energy / (np.sum(rest**2) or 1))

    def share(planes: Array) -> float:
        by_chance = max(explained(turned) for turned in _turned(planes, smooth, observation))
        return (explained(planes) - by_chance) / max(1 - by_chance, 1e-12)

    return share


def coarse_transport(A: Matrix, observation: Observation) -> Array:
    """Return A's used rows for hidden images of at most `COARSE` x `COARSE` patches, (M', n)."""
    rows, columns = observation.hidden_shape
    side = -(-max(rows, columns) // COARSE)
    row, column = np.divmod(np.arange(rows * columns), columns)
    coarse = (row // side) * -(-columns // side) + column // side
    summed = np.equal(coarse[:, None], np.arange(coarse.max() + 1)).astype(np.float64)
    A = A if hasattr(A, "row_blocks") else np.asanyarray(A)
    used: Any = A if observation.mask is None else used_rows(A, observation.mask.ravel())
    transport = np.empty((used.shape[0], summed.shape[1]))
    for part, block in row_blocks(used, ROWS):
        transport[part] = block @ summed
    return transport


def _turned(planes: Array, smooth: Array, observation: Observation) -> list[Array]:
    """Return (3, M') planes as a flipped photograph would have them, in each of `FLIPPED`.

    Where turning brings a pixel that is left out to one that is used, that one shows smooth light.
    """
    light = (planes @ smooth) @ smooth.T
    fine = np.nan_to_num(observation.placed((planes - light).T))
    turned = (fine[:, *flip] for flip in FLIPPED.values())
    used = slice(None) if observation.mask is None else observation.mask.ravel()
    return [light + each.reshape(3, -1)[:, used] for each in turned]
