"""Numerics that several rooms share: kinds of arrays, threads, large products, compiled loops."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]
