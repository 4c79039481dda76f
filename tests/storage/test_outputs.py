import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from periscopy_sim.errors import OutputError
from periscopy_sim.storage.outputs import append_array, staged_file, staged_folder
from periscopy_sim.storage.pictures import write_png
from periscopy_sim.storage.rasters import write_exr


def entries(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*")}


def entries_of(output: Path) -> set[str]:
    return {output.name} | {f"{output.name}/{entry}" for entry in entries(output)}


def test_file_appears_only_after_the_block(tmp_path):
    target = tmp_path / "made" / "too" / "A.npy"
    with staged_file(target) as staged:
        assert staged.parent == target.parent and staged.suffix == ".npy"
        staged.write_bytes(b"matrix")
        assert not target.exists()
    assert target.read_bytes() == b"matrix"
    assert entries(target.parent) == {"A.npy"}


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize("staged_output", [staged_file, staged_folder])
def test_failure_leaves_the_old_output_and_nothing_else(tmp_path, failure, staged_output):
    target = tmp_path / "y"
    old = target if staged_output is staged_file else target / "summary.json"
    old.parent.mkdir(exist_ok=True)
    old.write_bytes(b"old")
    before = entries(tmp_path)
    with pytest.raises(failure), staged_output(target) as staged:
        (staged if staged_output is staged_file else staged / "summary.json").write_bytes(b"half")
        raise failure
    assert old.read_bytes() == b"old" and entries(tmp_path) == before


@pytest.mark.parametrize("staged_output", [staged_file, staged_folder])
def test_a_file_system_that_cannot_be_written_is_named(tmp_path, monkeypatch, staged_output):
    """There, even the removal of a file that does not exist is an error."""

    def refuse(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    for change in ("touch", "mkdir", "unlink"):
        monkeypatch.setattr(Path, change, refuse)
    with (
        pytest.raises(OutputError, match=r"cannot write .*y: Read-only"),
        staged_output(tmp_path / "y"),
    ):
        pass


UNWRITABLE = [
    "/proc/x",
    "/proc/periscopy/y",
    "/dev/null/y",
    "{file}/y",
    "{file}/deep/y",
    "{root}/" + "y" * 256,
    "{root}/new/" + "y" * 256,
    "{root}/" + os.fsdecode(b"\xe9"),
    "s3://bucket/y.npy",
    "file:///y.npy",
    "{root}/\0",
]


@pytest.mark.parametrize("name", ["y" * 251 + ".npy", "y." + "z" * 253, "é" * 127])
def test_name_may_be_as_long_as_the_file_system_has_them(tmp_path, name):
    with staged_folder(tmp_path / name) as staged:
        (staged / "whole").write_text("whole")
    assert entries(tmp_path) == entries_of(tmp_path / name)


@pytest.mark.parametrize("staged_output", [staged_file, staged_folder])
def test_unwritable_place_is_refused_before_the_block(tmp_path, staged_output):
    file = tmp_path / "file"
    file.write_bytes(b"precious")
    for place in UNWRITABLE:
        path, entered = Path(place.format(file=file, root=tmp_path)), False
        with pytest.raises(OutputError) as caught, staged_output(path):
            entered = True
        assert not entered
        shown = str(path).replace("\0", "\\x00").replace("\udce9", "\\udce9")
        assert shown in str(caught.value) and "\n" not in str(caught.value)
        assert file.read_bytes() == b"precious" and entries(tmp_path) == {"file"}


def write_numpy(path):
    with staged_file(path) as staged:
        np.save(staged, np.ones(1 << 20))


@pytest.mark.parametrize(
    "write",
    [
        write_numpy,  # whose message has no error number
        lambda path: write_exr(path, np.random.default_rng(0).random((400, 400, 3)), {}),
        lambda path: write_png(path, np.random.default_rng(0).random((400, 400, 3)), {}),
    ],
)
def test_full_disk_is_reported_whatever_the_library_says(write, tmp_path):
    """A file that may not grow stands for a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, limits[1]))
    try:
        with pytest.raises(OutputError, match="free some space"):
            write(tmp_path / "A.npy")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    with pytest.raises(OutputError, match="free some space"), staged_file(tmp_path / "A"):
        raise OSError("8 requested and 4 written")
    with pytest.raises(OutputError, match="free some space"), staged_folder(tmp_path / "A"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(PermissionError), staged_file(tmp_path / "A"):
        raise PermissionError(errno.EACCES, "of something else the block opened")
    assert entries(tmp_path) == set()


STAGING = """
import sys, time
from pathlib import Path
from periscopy_sim.storage.outputs import staged_file, staged_folder
with {staged}(Path(sys.argv[1])) as staged:
    (staged / "half" if "folder" in "{staged}" else staged).write_text("half")
    print("staged", flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize("staged_output", [staged_file, staged_folder])
def test_next_run_removes_what_a_killed_one_left_and_only_that(tmp_path, staged_output):
    target = tmp_path / "out.x"
    others = {".out-1234.x", "out.x.partial", ".outer.x-12345678.partial.x"}
    for name in others:
        (tmp_path / name).write_text("mine")
    command = [sys.executable, "-c", STAGING.format(staged=staged_output.__name__), str(target)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as killed:
        assert killed.stdout.readline() == "staged\n"
        begun = entries(tmp_path)
        with pytest.raises(KeyError), staged_output(target):
            raise KeyError
        assert entries(tmp_path) == begun > others, "a run that is at work loses nothing"
        killed.kill()
    with staged_output(target) as staged:
        (staged if staged_output is staged_file else staged / "whole").write_text("whole")
    assert entries(tmp_path) == others | entries_of(target)


@pytest.mark.skipif(sys.platform == "win32", reason="locks nothing that is open")
def test_a_file_that_another_process_takes_for_a_leftover_is_made_anew(tmp_path, monkeypatch):
    touch, made = Path.touch, list[Path]()

    def taken_once(path):
        made.append(path)
        touch(path)
        if len(made) == 1:
            path.unlink()

    monkeypatch.setattr(Path, "touch", taken_once)
    with staged_file(tmp_path / "out.txt") as staged:
        staged.write_text("whole")
    assert len(made) == 2 and [*tmp_path.iterdir()] == [tmp_path / "out.txt"]
    assert (tmp_path / "out.txt").read_text() == "whole"


def test_existing_folder_keeps_its_other_files(tmp_path):
    target = tmp_path / "out"
    (target / "maps").mkdir(parents=True)
    (target / "maps" / "mine.txt").write_text("kept")
    (target / "summary.json").write_text("old")
    with staged_folder(target) as staged:
        (staged / "maps").mkdir()
        (staged / "maps" / "new.npy").write_text("new")
        (staged / "summary.json").write_text("new")
        assert (target / "summary.json").read_text() == "old"
    assert entries(target) == {"maps", "maps/mine.txt", "maps/new.npy", "summary.json"}
    assert (target / "summary.json").read_text() == "new"
    assert entries(tmp_path) == {f"out/{e}" for e in entries(target)} | {"out"}


def test_file_does_not_replace_a_folder(tmp_path):
    (tmp_path / "b").mkdir()
    with pytest.raises(OutputError, match="cannot write"), staged_folder(tmp_path) as staged:
        (staged / "b").write_text("new")
    assert entries(tmp_path) == {"b"}


def test_symbolic_link_is_followed(tmp_path):
    (tmp_path / "disk").mkdir()
    link = tmp_path / "y.npy"
    link.symlink_to(tmp_path / "disk" / "y.npy")
    with staged_file(link) as staged:
        staged.write_bytes(b"new")
    assert link.is_symlink() and (tmp_path / "disk" / "y.npy").read_bytes() == b"new"


def test_a_stack_is_whole_at_any_moment(tmp_path):
    file = tmp_path / "frames.npy"
    file.write_bytes(b"of a former run, and longer than what is written now" * 99)
    arrays = np.random.default_rng(0).normal(size=(12, 3, 4, 3)).astype(np.float32)
    for k, each in enumerate(arrays):  # the header keeps its length from 9 to 10
        append_array(file, each.astype(np.float64), k)
        np.testing.assert_array_equal(np.load(file), arrays[: k + 1])
    with file.open("ab") as other:  # the writer is killed amid a frame
        other.write(b"half a frame")
    np.testing.assert_array_equal(np.load(file), arrays)


def test_what_cannot_be_written_is_an_error_of_the_output(tmp_path):
    with pytest.raises(OutputError, match=r"nowhere/frames\.npy"):
        append_array(tmp_path / "nowhere" / "frames.npy", np.zeros(3), 0)
