"""A data set as PyTorch reads it; nothing here is imported from PyTorch before it is needed."""

import os
from collections.abc import Callable, Sequence
from operator import index
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.dataset.reading import open_dataset
from periscopy_sim.errors import DatasetError
from periscopy_sim.extras import require
from periscopy_sim.storage.outputs.places import place
from periscopy_sim.storage.outputs.store import opened


class TorchDataset:
    """Samples of a data set as tensors, channels first: a map-style data set for PyTorch.

    Safe to hand to a `DataLoader` with any number of workers: each opens the archive for itself.
    A batch reads its own samples alone, in any order: of each variable and block an index, and for
    each sample a range of bytes, which adds less than 2 % to what is stored. The name can be looked
    up without PyTorch; making one needs it.

    Parameters
    ----------
    path
        The archive that `periscopy dataset` wrote.
    split
        ``train``, ``validation`` or ``test``; None for all.
    variables
        Names of the variables that a sample holds, or one name.
    transform
        Applied to each sample, a dict of tensors.

    Raises
    ------
    DatasetError
        If the path holds no finished data set, the split no samples, or a variable is not known.
    """

    def __init__(
        self,
        path: str | Path,
        split: str | None = None,
        variables: Sequence[str] | str = ("photograph", "hidden"),
        transform: Callable[[dict[str, Any]], Any] | None = None,
    ) -> None:
        require("torch")
        variables = (variables,) if isinstance(variables, str) else tuple(variables)
        data = open_dataset(path)
        for name in variables:
            if name not in data.variables or data[name].dims[0] != "sample":
                known = ", ".join(sorted(map(str, data.variables)))
                raise DatasetError(f"{path}: has no variable '{name}' of samples; it has {known}")
        splits = data["split"].values
        self.samples = np.arange(len(splits)) if split is None else np.flatnonzero(splits == split)
        if not len(self.samples):
            known = ", ".join(sorted({*splits.tolist()}))
            raise DatasetError(f"{path}: has no samples of split '{split}'; it has {known}")
        self.path, self.variables, self.transform = place(path), variables, transform
        self._opened: tuple[int, Any] | None = None

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.samples)

    def __getitem__(self, number: int) -> Any:
        """Return a sample: its variables' tensors by name.

        A `DataLoader` makes batches, and ``torch.utils.data.Subset`` is a part of the samples.
        """
        return self.__getitems__([number])[0]

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Return the samples of a batch, read at once, as PyTorch's loaders ask for them."""
        # An archive opened before a fork waits for threads that the fork has left behind.
        if self._opened is None or self._opened[0] != os.getpid():
            self._opened = os.getpid(), opened(self.path)
        group = self._opened[1]
        chosen = self.samples[np.array([*map(index, indices)], int)]
        wanted, places = np.unique(chosen, return_inverse=True)
        columns = {name: group[name].oindex[wanted][places] for name in self.variables}
        samples = [{n: _tensor(v[k]) for n, v in columns.items()} for k in range(len(places))]
        return samples if self.transform is None else [self.transform(each) for each in samples]

    def __getstate__(self) -> dict[str, Any]:
        """Leave the opened archive behind."""
        return {**self.__dict__, "_opened": None}


def _tensor(value: Any) -> Any:
    """Return a picture as a tensor, channels first, a number as one, text as it is."""
    import torch

    if isinstance(value, str):
        return value
    return torch.as_tensor(np.ascontiguousarray(np.moveaxis(value, -1, 0)) if value.ndim else value)
