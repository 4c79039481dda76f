"""A data set on disk: a Zarr v3 archive that no crash can spoil.

Samples are made and kept in blocks, each with files of its own. A block counts as done once its
mark stands in ``making/finished``, which tells the checksum of each of its files; a block whose
files are not what its mark says is made again. Chunks carry a checksum of their own, so that a
damaged one is an error to any reader, not a sample. Nothing measured lies in the archive: the same
configuration gives the same bytes, however often its making was stopped, and by whomever.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.dataset.archive.completion import (
    checksum,
    file_of,
    is_finished,
    is_marked,
    mark_of,
    read_mark,
)
from periscopy_sim.dataset.archive.layout import (
    LABELS,
    MAKING,
    PATCHES,
    PIXELS,
    VARIABLES,
    Layout,
    digest_of,
    read_attributes,
)
from periscopy_sim.dataset.making.samples import Block
from periscopy_sim.errors import DatasetError, OutputError
from periscopy_sim.storage.outputs.lock import LOCK
from periscopy_sim.storage.outputs.resume import check_settings
from periscopy_sim.storage.outputs.staging import out_of_space_reported, staged_file


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
        head = path / MAKING / "head"
        with out_of_space_reported(path):
            _clear(path, head)
            for block in self._numbers():  # before the head tells of more samples than it has
                if not is_marked(path, layout, self.digest, block):
                    mark_of(path, block).unlink()
            _lay_out(head, layout, attributes, geometries)
            _replace_what_differs(head, path)
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
        with out_of_space_reported(self.path), _writing(self.path):
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
        read = ((block, read_mark(self.path, block)) for block in self._numbers())
        marks = {block: mark for block, mark in read if mark is not None}
        if not marks:
            return  # there is nothing to lose: what there is of a head is written anew
        try:
            held = read_attributes(self.path)
        except DatasetError:
            held = {}
        known = {mark["of"] for mark in marks.values()}
        if digest_of(held) != self.digest and self.digest not in known:
            if held:
                del held["count"]
                check_settings(held, wanted, str(self.path), "data set")
            raise OutputError(
                f"{self.path} holds samples of another data set, whose head is lost; name another "
                "folder, or remove it to start anew"
            )
        # Where head and marks contradict each other, one of them is damaged, and made anew.
        last = max(marks)
        beyond = last * self.layout.block + marks[last]["samples"] > self.layout.count
        if beyond and held.get("count", np.inf) > self.layout.count:
            raise OutputError(
                f"{self.path} holds more than {self.layout.count} samples; ask for as many or "
                "more, or name another folder"
            )

    def _numbers(self) -> list[int]:
        """Numbers of the blocks that have a mark, whole or not."""
        marks = (self.path / MAKING / "finished").glob("*.json")
        return sorted(int(file.stem) for file in marks if file.stem.isdecimal())


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
        making = path / MAKING
        begun = any((making / name).is_file() for name in ("zarr.json", LOCK))
        if begun or not path.is_dir() or not any(path.rglob("*")):
            return
        try:
            read_attributes(path)
        except DatasetError:
            if any(file.is_file() for file in path.rglob("*")):
                raise OutputError(
                    f"{path} is not empty and no data set; name another folder"
                ) from None
    except OSError as error:
        raise OutputError(f"cannot read {path}: {error.strerror}; name another folder") from error


def _clear(path: Path, head: Path) -> None:
    """Remove what a run that was killed has left of its writing."""
    shutil.rmtree(head, ignore_errors=True)
    places = [path / MAKING, *(path / name for name in VARIABLES)]
    for torn in (file for place in places for file in place.rglob("*") if file.is_file()):
        hidden = torn.name.startswith(".") and torn.name != LOCK and MAKING in torn.parts
        if hidden or torn.suffix == ".partial":
            torn.unlink()


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Tell what the system has against a file within the archive; a full disk is told elsewhere."""
    try:
        yield
    except (IsADirectoryError, NotADirectoryError, PermissionError) as error:
        raise OutputError(
            f"cannot write {error.filename or path}: {error.strerror}; remove what stands there"
        ) from error


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
    for name, dtype in LABELS.items():
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
    shutil.rmtree(new)
