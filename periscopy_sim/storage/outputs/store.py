"""A Zarr v3 store that no crash can spoil, filled block by block over many runs.

Each block has files of its own. It counts as done once its completion record stands in
``making/finished``, which holds the checksum of each of these files; a block whose files are not
what its record says is made again. Chunks carry a checksum of their own, so that a damaged one is
an error to any reader, not a result. Nothing measured, such as times, lies in the store: the same
attributes give the same bytes, however often the work was stopped, and by whomever.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError
from periscopy_sim.storage.outputs.completion import (
    MAKING,
    Block,
    digest_of,
    is_complete,
    is_recorded,
    read_record,
    record_file,
    record_of,
    recorded_blocks,
)
from periscopy_sim.storage.outputs.resume import LOCK, check_settings
from periscopy_sim.storage.outputs.staging import out_of_space_reported, staged_file, staged_folder


class StoreLayout(Protocol):
    """What a store holds, and how it is cut into blocks."""

    @property
    def what(self) -> str:
        """Return what to call the store in messages: a sweep."""

    @property
    def count(self) -> int | None:
        """Return the entries, where they may become more from run to run; None elsewhere."""

    @property
    def blocks(self) -> int:
        """Return the number of blocks."""

    def block(self, number: int) -> Block:
        """Return a block."""

    def variables(self) -> dict[str, dict[str, Any]]:
        """Return what `zarr.Group.create_array` takes for each variable that blocks hold."""

    def recognizes(self, attributes: Mapping[str, Any]) -> bool:
        """Return whether attributes are those of such a store."""


class BlockStore:
    """A store in the making or complete; one process writes to it at a time.

    The folder is made if missing, complete with its labels or not at all. The layout's `count` may
    be larger than before. `attributes`, of JSON's types, are all that the entries depend on: a
    folder of others, or of something else, is an `OutputError`. `labels` are the dimension and the
    values of each variable that is there from the start.
    """

    def __init__(
        self,
        path: Path,
        layout: StoreLayout,
        attributes: Mapping[str, Any],
        labels: Mapping[str, tuple[str, Any]],
    ) -> None:
        import zarr

        self.path, self.layout = path, layout
        self.digest = digest_of(attributes)
        check_place(path, layout.what, layout.recognizes)
        self._check_held(attributes)
        with out_of_space_reported(path):
            self._remove_what_was_torn()
            for number in recorded_blocks(path):  # before the head tells of more than there is
                in_range = number < layout.blocks
                if not (in_range and is_recorded(path, self.digest, layout.block(number))):
                    record_file(path, number).unlink()
            # The head of the whole comes last: `zarr.json` is behind all other names.
            with staged_folder(path) as head:
                self._lay_out(head, attributes, labels)
        self._group: Any = zarr.open_group(path, mode="r+", zarr_format=3)

    def missing(self) -> Iterator[int]:
        """Yield the numbers of the blocks that are missing, smaller, or not what was written."""
        for number in range(self.layout.blocks):
            if not is_complete(self.path, self.digest, self.layout.block(number)):
                yield number

    def write(self, number: int, values: Mapping[str, NDArray[Any]]) -> None:
        """Keep a block, and record that it is complete; the last may be cut short."""
        block = self.layout.block(number)
        with out_of_space_reported(self.path), _writing(self.path):
            file = record_file(self.path, number)
            file.unlink(missing_ok=True)
            for name, each in values.items():
                # Zarr would read what is there, whole or not.
                (self.path / block.files[name]).unlink(missing_ok=True)
                array = self._group[name]
                dimensions = array.metadata.dimension_names
                place = tuple(block.place.get(d, slice(None)) for d in dimensions)
                lengths = (p.stop - p.start if p.stop is not None else None for p in place)
                array[place] = each[tuple(slice(length) for length in lengths)]
            with staged_file(file) as staged:
                record = record_of(self.path, self.digest, block)
                staged.write_text(json.dumps(record) + "\n", "utf-8")

    def _check_held(self, wanted: Mapping[str, Any]) -> None:
        """Refuse entries of other attributes; records tell what they are of, or else the head."""
        path, what = self.path, self.layout.what
        read = ((number, read_record(path, number)) for number in recorded_blocks(path))
        records = {number: record for number, record in read if record is not None}
        if not records:
            return  # there is nothing to lose: what there is of a head is written anew
        held = attributes_of(path)
        known = {record["of"] for record in records.values()}
        if digest_of(held) != self.digest and self.digest not in known:
            if held:
                held.pop("count", None)
                check_settings(held, wanted, str(path), what)
            raise OutputError(
                f"{path} holds another {what}, whose head is lost; name another folder, or remove "
                "it to start anew"
            )
        # Where head and records contradict each other, one of them is damaged, and made anew.
        last, count = max(records), self.layout.count
        beyond = (
            last >= self.layout.blocks or records[last]["samples"] > self.layout.block(last).size
        )
        if beyond and count is not None and held.get("count", np.inf) > count:
            raise OutputError(
                f"{path} holds more than {count} samples; ask for as many or more, or name another "
                "folder"
            )

    def _lay_out(
        self, head: Path, attributes: Mapping[str, Any], labels: Mapping[str, tuple[str, Any]]
    ) -> None:
        """Write a store without blocks; xarray reads it."""
        import zarr

        count = {} if self.layout.count is None else {"count": self.layout.count}
        group = zarr.create_group(head, zarr_format=3, attributes={**attributes, **count})
        making = zarr.create_group(head / MAKING, zarr_format=3)
        making.attrs["description"] = "marks of the blocks that are finished, and what made them"
        for name, settings in self.layout.variables().items():
            group.create_array(name, **settings)
        for name, (dimension, values) in labels.items():
            is_text = isinstance(values[0], str)
            array = np.array(values, np.dtypes.StringDType() if is_text else None)
            group.create_array(name, data=array, dimension_names=(dimension,))

    def _remove_what_was_torn(self) -> None:
        """Remove what a run that was killed has left of its writing."""
        places = [self.path / name for name in (MAKING, *self.layout.variables())]
        for torn in (file for place in places for file in place.rglob("*") if file.is_file()):
            hidden = torn.name.startswith(".") and torn.name != LOCK and MAKING in torn.parts
            if hidden or torn.suffix == ".partial":
                torn.unlink()


def attributes_of(path: Path) -> dict[str, Any]:
    """Return the attributes of a store; none where its head is missing or damaged."""
    try:
        return dict(json.loads((path / "zarr.json").read_text("utf-8"))["attributes"])
    except (ValueError, KeyError, TypeError, OSError):
        return {}


def check_place(path: Path, what: str, recognizes: Callable[[Mapping[str, Any]], bool]) -> None:
    """Refuse a place that holds anything but such a store, whole or begun."""
    try:
        if path.exists() and not path.is_dir():
            raise OutputError(f"cannot write {path}: it is a file; name a folder")
        begun = any((path / MAKING / name).is_file() for name in ("zarr.json", LOCK))
        if begun or recognizes(attributes_of(path)):
            return
        if any(file.is_file() for file in path.rglob("*")):
            raise OutputError(f"{path} is not empty and no {what}; name another folder")
    except OSError as error:
        raise OutputError(f"cannot read {path}: {error.strerror}; name another folder") from error


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Report what the system has against a file within the store."""
    try:
        yield
    except (IsADirectoryError, NotADirectoryError, PermissionError) as error:
        raise OutputError(
            f"cannot write {error.filename or path}: {error.strerror}; remove what stands there"
        ) from error
