"""Published photographs of hidden scenes: downloaded once, checked by their sums, and read.

Each laboratory has a layout of its own: raw Bayer counts, a file for each colour, or several
arrays in one file.
"""

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError, PhotographError, did_you_mean, require
from periscopy_sim.storage import outputs, pictures, places, rasters

REPEATS = ("averaged_iterations", "iterations")
"""Fields for the number of exposures; the first takes precedence."""

FILM = (126, 126)
"""(rows, columns) of the cameras of the shipped scenes."""

COLOURS = ("_red", "_green", "_blue")
"""Ends of the names of three files that make one photograph."""

DECODING = 2.2
"""Power of such a file's values that is linear light. The noise of single exposures falls with
brightness, as that of encoded light does. Of 1, 1.7, 2.2, 2.6 and 3 this power leaves the least of
a room's ambient light outside range(B): `experiments.published.rooms`."""

Layout = Literal["captures", "colours", "arrays"]


@dataclass(frozen=True)
class PublishedSet:
    """A set of captures: `parameters` are of its shipped `scene`, `files` have their SHA-256.

    The `layout` says how files are read: see `read_capture`, `read_colours` and `read_arrays`.
    """

    what: str
    geometry: str
    licence: str
    cite: str
    url: str
    scene: str
    parameters: Mapping[str, float]
    files: Mapping[str, str]
    layout: Layout = "captures"

    def arrays(self, folder: Path) -> Iterator[tuple[str, dict[str, NDArray[np.float64]]]]:
        """Yield name and arrays of each photograph that lies in a folder, for an NPZ file."""
        for file in self.files:
            name = file.removesuffix(".mat")
            if self.layout == "captures":
                yield name, read_capture(folder / file)
            elif self.layout == "arrays":
                yield name, read_arrays(folder / file)
            elif name.endswith(COLOURS[0]):
                whole = name.removesuffix(COLOURS[0])
                paths = [folder / f"{whole}{colour}.mat" for colour in COLOURS]
                yield whole, {"photograph": read_colours(paths)}


def published_sets() -> dict[str, PublishedSet]:
    """Return every set by its name."""
    registry = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
    shared = registry["collections"]
    return {
        name: PublishedSet(**shared[_collection(name)], **fields)
        for name, fields in registry["sets"].items()
    }


def fetch(name: str, progress: Callable[[int, int], None] | None = None) -> Path:
    """Download a set of published photographs, once.

    The files lie in the folder ``PERISCOPY_DATA`` if this variable of the environment is set, else
    in the user's cache. Files that an interrupted download completed stay there.

    Parameters
    ----------
    name
        A set such as ``saunders2019-chair``; ``periscopy fetch`` lists all.
    progress
        Called with the number of files that are there, and of all.

    Returns
    -------
    Path
        The folder of the set's collection, with the files as their authors lay them out.

    Raises
    ------
    PeriscopyError
        If there is no such set, a file cannot be downloaded, or differs from the published one.
    """
    import pooch
    from requests import RequestException

    sets = published_sets()
    if name not in sets:
        guess = did_you_mean(name, sets)
        raise PeriscopyError(f"no set '{name}'; {guess or 'name one of ' + ', '.join(sets)}")
    url, files = sets[name].url, sets[name].files
    root = places.user_cache()
    pooch.get_logger().setLevel("WARNING")  # `progress` reports
    cache = pooch.create(root / _collection(name), url, registry=dict(files), retry_if_failed=1)
    with outputs.alone_in(root):
        for number, file in enumerate(files):
            if progress is not None:
                progress(number, len(files))
            try:
                cache.fetch(file)
            except (RequestException, ValueError) as error:  # ValueError: another checksum
                raise PeriscopyError(
                    f"{file}: {url} did not send the published file ({type(error).__name__}); "
                    "check the network and run this again"
                ) from None
    return Path(cache.abspath)


def _collection(name: str) -> str:
    """Return the collection of a set, its name up to the first hyphen."""
    return name.partition("-")[0]


def read_capture(path: Path) -> dict[str, NDArray[np.float64]]:
    """Return a published capture as arrays that `read_photograph` and `read_hidden_image` know.

    They are ``photograph``, (126, 126, 3) linear counts for each unit of exposure, and ``hidden``,
    (rows, columns, 3) linear, what the monitor showed, if the file has it. A file that is damaged
    or of another layout is a `PhotographError`.
    """
    fields = capture_fields(path)
    light = pictures.area_average(rasters.bayer_colours(fields["image"]), FILM)
    light, hidden = light / capture_exposure(fields), capture_truth(fields)
    return {"photograph": light} | ({} if hidden is None else {"hidden": hidden})


def read_colours(paths: Sequence[Path]) -> NDArray[np.float64]:
    """Return one photograph, (rows, columns, channels), of a MATLAB 7.3 file for each channel.

    Each file has the field ``im``, (rows, columns), encoded and scaled to a largest value of 1: the
    channels' gains are not known. A file that is damaged, or of another size or layout, is a
    `PhotographError`; a PeriscopyError says how to install what reads such files.
    """
    h5py, channels = require("h5py"), list[NDArray[np.float64]]()
    for path in paths:
        with rasters.decoding(path, "MATLAB 7.3"), h5py.File(path, "r") as file:
            values = np.asarray(file["im"][()], np.float64).T  # MATLAB counts columns first
            if values.ndim != 2 or (channels and values.shape != channels[0].shape):
                raise PhotographError(f"{path}: 'im' has shape {values.shape}; download it again")
            channels.append(values)
    return np.asarray(np.maximum(np.stack(channels, axis=2), 0) ** DECODING)


def _matlab(path: Path, *names: str) -> dict[str, NDArray[Any]]:
    """Return arrays of real numbers, all or some, of a MATLAB file of version 5 to 7."""
    from scipy.io import loadmat

    with rasters.decoding(path, "MATLAB", "save it again with -v7"), path.open("rb") as file:
        fields = loadmat(file, variable_names=names or None)
        return {n: f for n, f in fields.items() if getattr(f, "dtype", np.dtype("O")).kind in "iuf"}


def read_arrays(path: Path) -> dict[str, NDArray[np.float64]]:
    """Return the square pictures of a MATLAB file of version 5, each (n, n, 1), by their names.

    A column of n² numbers is a picture whose columns stand one below the other. A file that is
    damaged, or without pictures, is a `PhotographError`.
    """
    squares = dict[str, NDArray[np.float64]]()
    for name, values in _matlab(path).items():
        side = math.isqrt(values.size)
        if side > 1 and values.shape in {(side, side), (side**2, 1), (1, side**2)}:
            squares[name] = values.astype(np.float64).reshape(side, side, 1, order="F")
    if not squares:
        raise PhotographError(f"{path}: has no square picture")
    return squares


def capture_fields(path: Path) -> dict[str, NDArray[Any]]:
    """Return those fields of a capture, a MATLAB file of version 5 to 7, that hold real numbers."""
    fields = _matlab(path, "image", "shutter_speed", *REPEATS, "ground_truth")
    if not ({"image", "shutter_speed"} <= fields.keys() and {*REPEATS} & fields.keys()):
        raise PhotographError(f"{path}: needs image, shutter_speed and {REPEATS[-1]}")
    return fields | {"image": fields["image"].astype(np.float64)}


def capture_exposure(fields: Mapping[str, NDArray[Any]]) -> float:
    """Return a capture's shutter speed times its number of exposures."""
    repeats = next(fields[name] for name in REPEATS if name in fields)
    return float(fields["shutter_speed"].item() * repeats.item())


def capture_truth(fields: Mapping[str, NDArray[Any]]) -> NDArray[np.float64] | None:
    """Return what the monitor was sent, as linear light, (rows, columns, 3); None if unknown.

    A black image counts as none, since nothing can be compared with it. What was sent is of 0 to
    255, or of 0 to 1 where nothing is larger, and encoded by the sRGB curve, as monitors take it.
    """
    values = fields.get("ground_truth")
    if values is None or values.ndim != 3 or values.shape[2] != 3 or not values.size:
        return None
    sent = np.asarray(values, np.float64)
    if not sent.any():
        return None
    whole = values.dtype.kind in "ui" or sent.max() > 1
    return np.asarray(rasters.srgb_decode(sent / 255 if whole else sent))
