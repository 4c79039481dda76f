"""Whether a photograph taken for one with the monitor off still shows the monitor.

What smooth light leaves of it is paint, noise, shadows of lamps; or light of the monitor, which an
image f ≥ 0 then explains by A. So do images by chance, the more the smoother paint or shadows are;
but they explain as much of the photograph turned upside down, left to right, or both, where the
monitor's light does not fit. Of what the best of these leaves, the part that the photograph as it
stands explains beyond is compared with `MOST`.

Measured on 13 photographs with the monitor off (chair and lamp; paint of up to 0.8 % in grains of 1
to 12 pixels, bars of light, the occluder's shadow as other lamps cast it): at most 0.05. With the
monitor on, as bright as ambient light or a third of it, paint of up to 0.8 %: 0.29 to 0.87 (9
photographs); a tenth as bright: 0.08 to 0.8 (6), seen in half. Less does little harm.
"""

from __future__ import annotations

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

Array = NDArray[np.float64]

MOST = 0.25
"""Part that light of no monitor explains, beyond what it explains turned."""

COARSE = 12
"""Patches along the longer side of the images tried: a monitor's light shows in these, too."""

ROWS = 1024
"""Rows of A that are summed at once."""


def check_monitor_off(A: Matrix, smooth: Array, observation: Observation) -> None:
    """Refuse background photographs that still show the monitor; a ValueError names the first.

    A is (M, N), the smooth light an orthonormal basis of range(B), (M', r). Where the photographs'
    rows and columns are not known, they cannot be turned, and nothing is refused.
    """
    if observation.rows_and_columns is None or not smooth.shape[1]:
        return
    transport = coarse_transport(A, observation)
    transport -= smooth @ (smooth.T @ transport)
    basis, R = np.linalg.qr(transport)
    for name, planes in observation.backgrounds.items():

        def share(planes: Array) -> float:
            """Return the part of what smooth light leaves that an image explains."""
            rest = planes - (planes @ smooth) @ smooth.T
            explained = sum(float(z @ z) - nnls(R, z)[1] ** 2 for z in rest @ basis)
            return float(explained / (np.sum(rest**2) or 1))

        by_chance = max(share(turned) for turned in _turned(planes, smooth, observation))
        if share(planes) - by_chance > MOST * (1 - by_chance):
            raise ValueError(
                f"{name}: still shows the monitor, or is the photograph itself; switch the monitor "
                "off, or cover it"
            )


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
    """Return (3, M') planes upside down, left to right, and both.

    Where turning brings a pixel that is left out to one that is used, that one shows smooth light.
    """
    light = (planes @ smooth) @ smooth.T
    fine = np.nan_to_num(observation.placed((planes - light).T))
    turned = (fine[:, ::-1], fine[:, :, ::-1], fine[:, ::-1, ::-1])
    used = slice(None) if observation.mask is None else observation.mask.ravel()
    return [light + each.reshape(3, -1)[:, used] for each in turned]
