"""Files that grow: readers find whole arrays and rows at any moment, however the writer ends."""

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from periscopy_sim.storage.outputs.staging import unwritable_reported


class GrowingStack:
    """A stack of float32 arrays of one shape, in place of a former file.

    The header counts an array once its values are written. An OutputError says that the file cannot
    be written.
    """

    def __init__(self, path: Path, shape: tuple[int, ...]) -> None:
        self.path, self.count, self._shape = path, 0, shape
        with unwritable_reported(path):
            self._file = path.open("w+b")
        self._write_header()

    def append(self, values: NDArray[np.floating]) -> None:
        """Write one array more."""
        if values.shape != self._shape:
            raise ValueError(f"{self.path} holds arrays of shape {self._shape}, not {values.shape}")
        with unwritable_reported(self.path):
            self._file.seek(0, 2)
            self._file.write(np.ascontiguousarray(values, "<f4").tobytes())
            self._file.flush()
            self.count += 1
            self._write_header()

    def _write_header(self) -> None:
        """Write the header, whose length NumPy keeps while the first axis grows."""
        self._file.seek(0)
        shape = self.count, *self._shape
        header = {"descr": "<f4", "fortran_order": False, "shape": shape}
        npy.write_array_header_1_0(self._file, header)
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class GrowingTable:
    """A CSV file of some columns, in place of a former one; entries of other names are left out.

    An OutputError says that the file cannot be written.
    """

    def __init__(self, path: Path, columns: Iterable[str]) -> None:
        self.path, self.count = path, 0
        with unwritable_reported(path):
            self._file = path.open("w", encoding="utf-8", newline="")
        form: dict[str, Any] = {"extrasaction": "ignore", "lineterminator": "\n"}
        self._table = csv.DictWriter(self._file, [*columns], **form)

    def append(self, row: Mapping[str, Any]) -> None:
        """Write one row more."""
        with unwritable_reported(self.path):
            if not self.count:
                self._table.writeheader()
            self._table.writerow(row)
            self._file.flush()
            self.count += 1

    def close(self) -> None:
        """Close the file."""
        self._file.close()
