"""A data set on disk: a Zarr v3 archive that no crash can spoil.

Samples are made and kept in blocks, each with files of its own. A block counts as done once its
mark stands in ``making/finished``, which tells the checksum of each of its files; a block whose
files are not what its mark says is made again. Chunks carry a checksum of their own, so that a
damaged one is an error to any reader, not a sample. Nothing measured lies in the archive: the same
configuration gives the same bytes, however often its making was stopped, and by whomever.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from periscopy_sim.dataset.samples import Block
from periscopy_sim.errors import DatasetError, OutputError
from periscopy_sim.storage.held_settings import check_settings
from periscopy_sim.storage.output import out_of_space_reported, staged_file

MAKING = "making"
"""Folder (and empty Zarr group) of what belongs to the making alone."""

KIND = "periscopy data set"

PIXELS = ("row", "column", "channel")
PATCHES = ("hidden_row", "hidden_column", "channel")

VARIABLES: dict[str, dict[str, str]] = {
    "photograph": {
        "long_name": "photograph of the wall, linear light",
        "units": "mean of a photograph of exposure 1",
    },
    "hidden": {"long_name": "hidden image, linear light", "units": "white of the monitor"},
    "background": {
        "long_name": "ambient light of the photograph, without noise",
        "units": "mean of a photograph of exposure 1",
    },
    "signal_scale": {
        "long_name": "photograph's unit over that of A f: photograph = scale A f + background",
        "units": "1",
    },
    "sbr": {"long_name": "signal-to-background ratio", "units": "1"},
    "snr": {"long_name": "signal-to-noise ratio", "units": "dB"},
    "exposure": {"long_name": "mean of the photograph without noise", "units": "1"},
    "clip_number": {"long_name": "number of the video that the photograph is of"},
    "frame": {"long_name": "number of the frame within its video"},
    "geometry": {"long_name": "number of the scene and its parameters"},
    "split": {"long_name": "train, validation or test"},
    "hidden_kind": {"long_name": "source of the hidden image"},
    "ambient": {"long_name": "source of the ambient light"},
}


@dataclass(frozen=True)
class Layout:
    """The sizes of a data set.

    Attributes
    ----------
    count
        Samples.
    block
        Samples in a block.
    photograph_shape, hidden_shape
        (rows, columns) and (R, C).
    photograph_type
        Of the photographs' numbers.
    keep_background
        Whether there is a variable `background`.
    """

    count: int
    block: int
    photograph_shape: tuple[int, int]
    hidden_shape: tuple[int, int]
    photograph_type: str
    keep_background: bool

    @property
    def blocks(self) -> int:
        """Number of blocks; the last may be cut short."""
        return -(-self.count // self.block)

    def samples_in(self, block: int) -> slice:
        """Give the indices of a block's samples."""
        return slice(block * self.block, min((block + 1) * self.block, self.count))


class Archive:
    """A data set in the making or complete; one process writes to it at a time.

    Parameters
    ----------
    path
        A folder; made if missing.
    layout
        Its sizes; `count` may be larger than before.
    attributes
        All that samples depend on, of JSON's types.
    geometries
        Variables of the dimension geometry, each with its values.

    Raises
    ------
    OutputError
        If the folder holds something else, or samples of other attributes.
    """

    def __init__(
        self,
        path: Path,
        layout: Layout,
        attributes: Mapping[str, Any],
        geometries: Mapping[str, Any],
    ) -> None:
        import zarr

        self.path, self.layout = path, layout
        self.digest = digest_of(attributes)
        self._check_held(attributes)
        for torn in path.rglob("*.partial"):  # of a write that was killed
            torn.unlink()
        with out_of_space_reported(path), TemporaryDirectory(dir=path / MAKING) as folder:
            _lay_out(Path(folder), layout, attributes, geometries)
            _replace_what_differs(Path(folder), path)
        self._group: Any = zarr.open_group(path, mode="r+", zarr_format=3)

    def unfinished(self) -> Iterator[int]:
        """Find the blocks that are missing, of fewer samples, or not what was written."""
        for block in range(self.layout.blocks):
            if not is_finished(self.path, self.layout, self.digest, block):
                yield block

    def write(self, block: int, values: Block) -> None:
        """Keep a block, and mark it finished.

        Raises
        ------
        OutputError
            If the disk is full.
        """
        place = self.layout.samples_in(block)
        count = place.stop - place.start
        with out_of_space_reported(self.path):
            mark = mark_of(self.path, block)
            mark.unlink(missing_ok=True)
            for name, each in values.items():
                # Zarr would read what is there, whole or not.
                file_of(self.path, name, each.ndim, block).unlink(missing_ok=True)
                self._group[name][place] = each[:count]
            record = {
                "of": self.digest,
                "samples": count,
                "crc32c": {name: checksum(self.path, name, block) for name in sorted(values)},
            }
            with staged_file(mark) as staged:
                staged.write_text(json.dumps(record) + "\n", "utf-8")

    def _check_held(self, wanted: Mapping[str, Any]) -> None:
        """Refuse samples of other attributes; the marks tell what they are of, or else the head."""
        marks = [_mark(file) for file in (self.path / MAKING / "finished").glob("*.json")]
        if any(block >= self.layout.blocks for block, _ in marks):
            raise OutputError(
                f"{self.path} holds more than {self.layout.count} samples; ask for as many or "
                "more, or name another folder"
            )
        known = {of for _, of in marks if of is not None}
        head = self.path / "zarr.json"
        if known == {self.digest} or not head.is_file() or (not known and _is_damaged(head)):
            return  # what there is of a head is written anew
        held = read_attributes(self.path)
        del held["count"]
        check_settings(held, wanted, str(self.path), "data set")


def check_place(path: Path) -> None:
    """Refuse a place that holds anything but a data set, whole or begun.

    Raises
    ------
    OutputError
        If it does, or cannot be read.
    """
    try:
        if path.exists() and not path.is_dir():
            raise OutputError(f"cannot write {path}: it is a file; name a folder")
        if path.is_dir() and any(path.iterdir()) and not (path / MAKING).is_dir():
            raise OutputError(f"{path} is not empty and no data set; name another folder")
    except OSError as error:
        raise OutputError(f"cannot read {path}: {error.strerror}; name another folder") from error


def read_attributes(path: Path) -> dict[str, Any]:
    """Read what a data set was made of.

    Raises
    ------
    DatasetError
        If the path holds no data set, or its head is damaged.
    """
    file = path / "zarr.json"
    if not file.is_file():
        what = "is no data set" if path.exists() else "no such data set"
        raise DatasetError(f"{path}: {what}; name a folder that 'periscopy dataset' has written")
    try:
        attributes = dict(json.loads(file.read_text("utf-8"))["attributes"])
        if attributes["kind"] == KIND and isinstance(attributes["count"], int):
            return attributes
    except (ValueError, KeyError, TypeError, OSError):
        pass
    raise DatasetError(
        f"{file}: is damaged, or of no data set; run 'periscopy dataset' into another folder"
    )


def digest_of(attributes: Mapping[str, Any]) -> str:
    """Tell data sets apart by all that their samples depend on; the count is not of it."""
    fixed = {name: value for name, value in attributes.items() if name != "count"}
    return hashlib.sha256(json.dumps(fixed, sort_keys=True).encode()).hexdigest()[:16]


def layout_of(attributes: Mapping[str, Any]) -> Layout:
    """Read the sizes from a data set's attributes."""
    sizes = attributes["layout"]
    return Layout(
        count=attributes["count"],
        block=sizes["block"],
        photograph_shape=tuple(sizes["photograph_shape"]),
        hidden_shape=tuple(sizes["hidden_shape"]),
        photograph_type=sizes["photograph_type"],
        keep_background=sizes["keep_background"],
    )


def is_finished(path: Path, layout: Layout, digest: str, block: int) -> bool:
    """Tell whether a block's files are there, whole and of as many samples as they should be.

    Parameters
    ----------
    path, layout
        The data set.
    digest
        Of its attributes, from `digest_of`.
    block
        Number of the block.
    """
    place = layout.samples_in(block)
    try:
        record = json.loads(mark_of(path, block).read_text("utf-8"))
        right = record["of"] == digest and record["samples"] == place.stop - place.start
        return right and all(
            checksum(path, name, block) == value for name, value in record["crc32c"].items()
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False


def mark_of(path: Path, block: int) -> Path:
    """Name the file that tells that a block is finished."""
    return path / MAKING / "finished" / f"{block:08d}.json"


def file_of(path: Path, name: str, dimensions: int, block: int) -> Path:
    """Name the file of a block's values of one variable."""
    return path.joinpath(name, "c", str(block), *["0"] * (dimensions - 1))


def checksum(path: Path, name: str, block: int) -> str:
    """CRC-32C of the file of a block's values of one variable, in hexadecimal."""
    import google_crc32c

    dimensions = 4 if name in ("photograph", "hidden", "background") else 1
    content = file_of(path, name, dimensions, block).read_bytes()
    return f"{google_crc32c.value(content):08x}"


def _mark(file: Path) -> tuple[int, str | None]:
    """Read a mark: its block, and the digest of what that is of."""
    try:
        return int(file.stem), json.loads(file.read_text("utf-8"))["of"]
    except (OSError, ValueError, KeyError, TypeError):
        return -1, None


def _is_damaged(head: Path) -> bool:
    """Tell whether a file is no JSON; one of other contents is not ours to replace."""
    try:
        json.loads(head.read_text("utf-8"))
    except ValueError:
        return True
    return False


def _lay_out(
    path: Path, layout: Layout, attributes: Mapping[str, Any], geometries: Mapping[str, Any]
) -> None:
    """Write an archive without samples; xarray reads it."""
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec

    group = zarr.create_group(path, zarr_format=3, attributes={**attributes, "count": layout.count})
    making = zarr.create_group(path / MAKING, zarr_format=3)
    making.attrs["description"] = "marks of the blocks that are finished, and what made them"
    pixels, patches = (*layout.photograph_shape, 3), (*layout.hidden_shape, 3)
    stacks: dict[str, tuple[tuple[int, ...], tuple[str, ...], str]] = {
        "photograph": (pixels, PIXELS, layout.photograph_type),
        "hidden": (patches, PATCHES, "float32"),
    }
    if layout.keep_background:
        stacks["background"] = pixels, PIXELS, layout.photograph_type
    # Shuffled bits compress what noise leaves alike: signs and exponents.
    for name, (shape, dimensions, dtype) in stacks.items():
        itemsize = np.dtype(dtype).itemsize
        blosc = BloscCodec(
            cname="zstd", clevel=1, shuffle="bitshuffle", typesize=itemsize, blocksize=0
        )
        group.create_array(
            name, shape=(layout.count, *shape), chunks=(1, *shape), shards=(layout.block, *shape),
            dtype=dtype, fill_value=np.nan, dimension_names=("sample", *dimensions),
            attributes=VARIABLES[name], compressors=[blosc, Crc32cCodec()],
        )  # fmt: skip
    for name, dtype in _LABELS.items():
        fill = "" if dtype is str else (np.nan if dtype == "float64" else -1)
        group.create_array(
            name, shape=(layout.count,), chunks=(layout.block,), dtype=dtype, fill_value=fill,
            dimension_names=("sample",), attributes=VARIABLES[name],
            compressors=[Crc32cCodec()],
        )  # fmt: skip
    for name, values in {**geometries, "channel": ["red", "green", "blue"]}.items():
        is_text = isinstance(values[0], str)
        array = np.array(values, np.dtypes.StringDType() if is_text else None)
        dimension = name if name == "channel" else "geometries"
        group.create_array(name, data=array, dimension_names=(dimension,))


_LABELS: dict[str, Any] = {
    "signal_scale": "float64",
    "sbr": "float64",
    "snr": "float64",
    "exposure": "float64",
    "clip_number": "int64",
    "frame": "int32",
    "geometry": "int32",
    "split": str,
    "hidden_kind": str,
    "ambient": str,
}


def _replace_what_differs(new: Path, old: Path) -> None:
    """Move every file over its namesake unless they are equal; the head of the whole last."""
    files = sorted(
        (file for file in new.rglob("*") if file.is_file()),
        key=lambda file: (file == new / "zarr.json", file),
    )
    for file in files:
        target = old / file.relative_to(new)
        if target.is_file() and target.read_bytes() == file.read_bytes():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        file.replace(target)
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir()  # for its owner to remove
