"""What the tests of sequences share: saving one in any form, and the line of an error."""

from functools import partial

import numpy as np
import pytest
import xarray as xr
import zarr


class Save:
    """Save photographs (frames, rows, columns, channels) as a sequence."""

    @staticmethod
    def folder(path, clip):
        path.mkdir()
        for k, frame in enumerate(clip):
            np.save(path / f"y{k}.npy", frame)

    @staticmethod
    def npz(path, clip):
        with path.open("wb") as stream:
            np.savez_compressed(stream, photograph=clip, other=np.zeros(3))

    @staticmethod
    def zarr(path, clip, zarr_format=3, chunks=None):
        dimensions = ("frame", "row", "column", "channel")
        dataset = xr.Dataset({"photograph": (dimensions, clip)})
        encoding = {"photograph": {"chunks": chunks or (5, *clip.shape[1:])}}
        dataset.to_zarr(path, zarr_format=zarr_format, consolidated=False, encoding=encoding)

    @staticmethod
    def bare_zarr(path, clip, zarr_format=3, **settings):
        zarr.create_array(path, data=clip, zarr_format=zarr_format, **settings)

    def by_name(self, path, clip, **settings):
        """Save in the form that the file's name stands for."""
        write = {
            "folder": self.folder,
            "y.npy": np.save,
            "y.npz": self.npz,
            "y.zarr": self.zarr,
            "v2.zarr": partial(self.zarr, zarr_format=2),
            "bare.zarr": self.bare_zarr,
            "bare2.zarr": partial(self.bare_zarr, zarr_format=2),
        }[path.name]
        write(path, clip, **settings)


@pytest.fixture
def save():
    return Save()


@pytest.fixture
def line_of():
    """Give the text of an error that `pytest.raises` caught, which must be one line."""

    def text_of(caught):
        text = str(caught.value)
        assert "\n" not in text
        return text

    return text_of
