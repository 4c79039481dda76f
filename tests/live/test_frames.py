import io
import os
import re
from pathlib import Path
from threading import Event, Thread, Timer

import numpy as np
import pytest
import tifffile

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.live import frames
from periscopy_sim.live.frames import CameraFolder, Latest, open_source
from periscopy_sim.storage.photographs import read_sensor_image

RNG = np.random.default_rng(2)


@pytest.fixture(autouse=True)
def hurried(monkeypatch):
    monkeypatch.setattr(frames, "POLL", 0.01)


@pytest.fixture
def said():
    return []


@pytest.fixture
def stopped():
    """Stop a source that waits for ever."""
    event = Event()
    late = Timer(60, event.set)
    late.start()
    yield event
    late.cancel()


def tiff(value):
    file = io.BytesIO()
    tifffile.imwrite(file, np.full((8, 8, 3), value, np.uint16), photometric="rgb")
    return file.getvalue()


def value_of(frame):
    return float(frame.values.mean())


def test_the_newest_of_a_thousand_files_is_taken_and_the_others_are_counted(
    tmp_path, said, stopped
):
    def write(numbers):
        for k in numbers:
            file = tmp_path / f"{k}.tif"
            file.write_bytes(tiff(1 + k))
            os.utime(file, (k, k))

    write(range(3))
    source = open_source(tmp_path)
    incoming = source(stopped, said.append)
    first = next(incoming)
    assert value_of(first) == 3 and first.number == 0  # the old ones are not late
    write(range(3, 1000))
    last = next(incoming)
    assert value_of(last) == 1000 and last.number == 997
    (tmp_path / "next.tif").write_bytes(tiff(7))
    assert value_of(next(incoming)) == 7
    assert said == []


def test_a_file_is_read_again_when_it_or_its_folder_is_written_anew(tmp_path, said, stopped):
    folder, others = tmp_path / "camera", [tmp_path / "later", tmp_path / "last"]
    file = folder / "latest.tif"
    folder.mkdir()
    file.write_bytes(tiff(1))
    incoming = open_source(folder)(stopped, said.append)
    assert value_of(next(incoming)) == 1
    file.write_bytes(tiff(2))
    assert value_of(next(incoming)) == 2

    def loses(k, value):
        folder.rename(others[k])
        Event().wait(0.2)
        folder.mkdir()
        file.write_bytes(tiff(value))

    for k in range(2):
        Thread(target=loses, args=(k, 3 + k)).start()
        assert value_of(next(incoming)) == 3 + k
    assert {line.rpartition("; ")[2] for line in said} == {"waiting for the folder"}


def test_half_files_wait_until_they_are_whole_and_foreign_ones_are_named(
    tmp_path, said, stopped, monkeypatch
):
    source = open_source(tmp_path)
    incoming = source(stopped, said.append)
    half = tmp_path / "a.tif"
    half.write_bytes(tiff(5)[:-20])
    for name in ("notes.txt", "more.txt", ".hidden.tif"):
        (tmp_path / name).write_text("x")
    Thread(target=lambda: stopped.wait(0.2) or half.write_bytes(tiff(5))).start()
    assert value_of(next(incoming)) == 5
    monkeypatch.setattr(frames, "PATIENCE", 0.05)
    (tmp_path / "b.tif").write_bytes(b"II*\0 and no more")
    (tmp_path / "empty.tif").touch()
    (tmp_path / "c.npy").write_bytes(b"another format")
    Thread(target=lambda: stopped.wait(0.5) or (tmp_path / "d.tif").write_bytes(tiff(6))).start()
    assert value_of(next(incoming)) == 6
    foreign, *others = sorted(said, key=lambda line: ".txt" not in line)
    assert "no photograph; ignored" in foreign and len(said) == 5
    assert any("b.tif" in line for line in others) and any("empty.tif" in line for line in others)
    assert any("c.npy" in line and "another format" in line for line in others)


def test_what_lay_in_a_folder_does_not_choose_its_format(tmp_path, said, stopped):
    np.save(tmp_path / "old.npy", np.ones((4, 6, 3)))
    incoming = open_source(tmp_path)(stopped, said.append)
    assert value_of(next(incoming)) == 1
    Thread(target=lambda: stopped.wait(0.3) or (tmp_path / "a.tif").write_bytes(tiff(5))).start()
    assert value_of(next(incoming)) == 5 and not said


def test_entries_that_are_no_files_do_not_stop_a_folder(tmp_path, said, stopped):
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "gone.tif").symlink_to("nowhere")
    (tmp_path / "folder.tif").mkdir()
    (tmp_path / "a.tif").write_bytes(tiff(5))
    assert value_of(next(open_source(tmp_path)(stopped, said.append))) == 5
    assert not said


def test_a_file_of_its_full_size_is_read_when_it_is_written_to_its_end(
    tmp_path, said, stopped, monkeypatch
):
    """As a copy over a network makes it: the size first, then the bytes, with a pause."""
    monkeypatch.setattr(frames, "ZEROS", 64)
    monkeypatch.setattr(frames, "PATIENCE", 2.0)
    file, whole = tmp_path / "a.tif", tiff(5)
    file.write_bytes(whole[: len(whole) // 2] + bytes(len(whole) - len(whole) // 2))
    Thread(target=lambda: stopped.wait(0.5) or file.write_bytes(whole)).start()
    incoming = open_source(tmp_path)(stopped, said.append)
    assert value_of(next(incoming)) == 5
    (tmp_path / "black.tif").write_bytes(tiff(0))  # dark to its last byte
    assert value_of(next(incoming)) == 0


def test_a_file_written_anew_while_it_is_read_is_one_frame(tmp_path, said, stopped):
    anew = iter([tiff(5)])

    def read(path):
        for whole in anew:
            path.write_bytes(whole)
        return read_sensor_image(path)

    (tmp_path / "a.tif").write_bytes(tiff(3))
    incoming = CameraFolder(tmp_path, read).frames(stopped, said.append)
    assert value_of(next(incoming)) == 5
    Thread(target=lambda: stopped.wait(0.3) or (tmp_path / "b.tif").write_bytes(tiff(6))).start()
    assert value_of(next(incoming)) == 6 and not said


def test_a_camera_faster_than_the_reading_makes_frames(tmp_path, said, stopped, monkeypatch):
    """And a script that moves photographs away as soon as they are there."""
    monkeypatch.setattr(frames, "PATIENCE", 0.05)
    values = iter(range(4, 1000))

    def read(path):
        light = read_sensor_image(path)
        path.unlink()
        path.with_name("latest.tif").write_bytes(tiff(next(values)))
        return light

    (tmp_path / "first.tif").write_bytes(tiff(3))
    incoming = CameraFolder(tmp_path, read).frames(stopped, said.append)
    first, *others = [value_of(next(incoming)) for _ in range(4)]
    assert first == 3 and others == sorted({*others})


CAMERA = """
import numpy as np
shots = iter([np.full((4, 4), 9, ">u2"), np.ones((4, 4, 3))])
frame = lambda: next(shots, None)
number = 3

def broken():
    raise RuntimeError("no camera")
"""


@pytest.fixture
def own(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(CAMERA)
    return file


def test_a_function_of_a_file_ends_with_none(own, said, stopped):
    got = [*open_source(f"{own}:frame")(stopped, said.append)]
    assert got[0].values.shape == (4, 4, 1) and (got[0].values == 9).all()
    assert got[0].values.dtype == np.uint16 and got[1].light.size == (4, 4)
    assert len(got) == 2 and "16-bit" in said[0]


def test_an_error_of_a_function_names_it_and_its_line(own, stopped):
    for camera, name in (f"{own}:broken", "mine.py:broken"), (broken_here, "broken_here"):
        with pytest.raises(PeriscopyError, match=name) as error:
            next(open_source(camera)(stopped, print))
        assert isinstance(error.value.__cause__, RuntimeError)
        file, line = re.search(r"\((.+):(\d+)\)$", str(error.value)).groups()
        text = (own if file == "mine.py" else Path(__file__)).read_text().splitlines()
        assert "raise RuntimeError" in text[int(line) - 1]


def broken_here():
    raise RuntimeError("no camera")


def test_what_is_no_source_is_named(own):
    for wrong, reason in {
        str(own.parent / "none"): "is no folder",
        str(own): "is no folder",
        "rtsp://camera/1": "is no folder",
        f"{own}:nothing": "'nothing'",
        f"{own}:number": "is no function",
        f"{own.parent}/none.py:frame": "FileNotFoundError",
    }.items():
        with pytest.raises(PeriscopyError, match=reason) as error:
            open_source(wrong)
        assert wrong in str(error.value)


def test_each_frame_of_a_buffer_is_a_copy(said, stopped):
    buffer, got = np.zeros((4, 4, 3), np.uint16), []
    for kind in np.uint16, np.float32:
        buffer = np.zeros((4, 4, 3), kind)

        def camera(buffer=buffer):
            buffer += 1
            return buffer if buffer.max() < 4 else None

        got = [*open_source(camera, linear=True)(stopped, said.append)]
        assert [float(each.values.max()) for each in got] == [1, 2, 3]


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (np.ma.masked_less(np.arange(16.0).reshape(4, 4), 3), "masked"),
        (np.full((4, 4), np.nan), "NaN"),
        (np.ones((4, 4), complex), "complex"),
        (np.ones(7), "shape"),
        ("no frame", r"shoot' \(test_frames.py:\d+\) returned a str"),
        ((True, np.ones((4, 4, 3))), r"\(test_frames.py:\d+\) returned a tuple"),
        ({"frame": 1}, "returned a dict"),
    ],
)
def test_what_is_no_frame_comes_as_its_error(frame, reason, said, stopped):
    shots = iter([frame, np.ones((4, 4, 3)), None])

    def shoot():
        return next(shots)

    got = [*open_source(shoot)(stopped, said.append)]
    assert isinstance(got[0], PhotographError) and re.search(reason, str(got[0]))
    assert got[1].values.shape == (4, 4, 3) and not said


def test_saturation_is_declared_or_a_plateau_is_named(said, stopped):
    codes = RNG.integers(100, 4000, (40, 40, 3)).astype(np.uint16)
    codes[:3] = 4095  # of 12 bits
    sources = [
        open_source(iter([codes, None]).__next__, linear=True, white=w) for w in (None, 4095)
    ]
    frames_of = [next(source(stopped, said.append)) for source in sources]
    assert [int(np.count_nonzero(each.light.saturated)) for each in frames_of] == [0, 120]
    assert sum("4095" in line for line in said) == 1


def test_late_items_are_dropped():
    place, got, free = Latest(), [], Event()

    def take():
        free.wait()
        got.extend(place)

    def put():
        for k in range(10):
            place.put(k)
        place.close()

    threads = [Thread(target=each) for each in (take, put)]
    threads[1].start()
    threads[1].join()
    free.set()
    threads[0].start()
    threads[0].join()
    assert got == [9]
