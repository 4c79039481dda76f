import io
import os
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import islice
from threading import Event, Thread, Timer

import numpy as np
import pytest
import tifffile
from PIL import Image

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live import frames
from periscopy_sim.live.frames import Latest, open_source
from periscopy_sim.storage.formats.decoding import LINEAR, SRGB
from tests.scenes.videos import write_video

RNG = np.random.default_rng(2)


@pytest.fixture(autouse=True)
def hurried(monkeypatch):
    monkeypatch.setattr(frames, "POLL", 0.01)
    monkeypatch.setattr(frames, "PAUSE", 0.01)


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
    return float(frame.values.values.mean())


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
    incoming = source.frames(stopped, said.append)
    assert value_of(next(incoming)) == 3 and source.dropped == 0  # the old ones are not late
    write(range(3, 1000))
    assert value_of(next(incoming)) == 1000 and source.dropped == 996
    (tmp_path / "next.tif").write_bytes(tiff(7))
    assert value_of(next(incoming)) == 7
    assert said == []


def test_a_file_is_read_again_when_it_or_its_folder_is_written_anew(tmp_path, said, stopped):
    folder, others = tmp_path / "camera", [tmp_path / "later", tmp_path / "last"]
    file = folder / "latest.tif"
    folder.mkdir()
    file.write_bytes(tiff(1))
    incoming = open_source(folder).frames(stopped, said.append)
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
    assert [line.rpartition("; ")[2] for line in said] == ["waiting for the folder"] * 2


def test_half_files_wait_until_they_are_whole_and_foreign_ones_are_named(
    tmp_path, said, stopped, monkeypatch
):
    source = open_source(tmp_path)
    incoming = source.frames(stopped, said.append)
    half = tmp_path / "a.tif"
    half.write_bytes(tiff(5)[:-20])
    for name in ("notes.txt", "more.txt", ".hidden.tif"):
        (tmp_path / name).write_text("x")
    Thread(target=lambda: stopped.wait(0.2) or half.write_bytes(tiff(5))).start()
    assert value_of(next(incoming)) == 5
    monkeypatch.setattr(frames, "PATIENCE", 0.05)
    (tmp_path / "b.tif").write_bytes(b"II*\0 and no more")
    (tmp_path / "c.npy").write_bytes(b"another format")
    Thread(target=lambda: stopped.wait(0.5) or (tmp_path / "d.tif").write_bytes(tiff(6))).start()
    assert value_of(next(incoming)) == 6
    foreign, *others = sorted(said, key=lambda line: ".txt" not in line)
    assert "no photograph; ignored" in foreign and len(said) == 3
    assert any("b.tif" in line for line in others)
    assert any("c.npy" in line and "another format" in line for line in others)


def test_what_lay_in_a_folder_does_not_choose_its_format(tmp_path, said, stopped):
    np.save(tmp_path / "old.npy", np.ones((4, 6, 3)))
    incoming = open_source(tmp_path).frames(stopped, said.append)
    assert value_of(next(incoming)) == 1
    Thread(target=lambda: stopped.wait(0.3) or (tmp_path / "a.tif").write_bytes(tiff(5))).start()
    assert value_of(next(incoming)) == 5 and not said


@pytest.mark.parametrize("first", [0, 3600])
def test_a_video_file_gives_every_frame_in_its_own_time(tmp_path, said, stopped, first):
    pytest.importorskip("av")
    codes = RNG.integers(0, 256, (12, 16, 24, 3), np.uint8)
    write_video(tmp_path / "v.mkv", codes, first=first)
    source = open_source(str(tmp_path / "v.mkv"))
    assert not source.is_live
    got = [*source.frames(stopped, said.append)]
    np.testing.assert_array_equal([each.values for each in got], codes)
    assert got[-1].time - got[0].time > 0.1 and got[0].encoding == SRGB and said == []
    assert open_source(str(tmp_path / "v.mkv"), linear=True)._encoding == LINEAR


class Camera(BaseHTTPRequestHandler):
    """A camera's MJPEG that ends after three frames at each visit."""

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace;boundary=b")
        self.end_headers()
        for _ in range(3):
            file = io.BytesIO()
            Image.fromarray(np.full((16, 24, 3), 90, np.uint8)).save(file, "JPEG")
            self.wfile.write(b"--b\r\nContent-Type: image/jpeg\r\n")
            self.wfile.write(b"Content-Length: %d\r\n\r\n" % len(file.getvalue()))
            self.wfile.write(file.getvalue() + b"\r\n")

    def log_message(self, *_):
        pass


@contextmanager
def camera():
    with ThreadingHTTPServer(("127.0.0.1", 0), Camera) as server:
        Thread(target=server.serve_forever).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()


def test_a_stream_that_ends_is_opened_again_until_it_does_not_come_back(said, stopped):
    pytest.importorskip("av")
    with camera() as url:
        source = open_source(url)
        incoming = source.frames(stopped, said.append)
        got = [*islice(incoming, 5)]
    assert {each.size for each in got} == {(16, 24)} and np.ptp(got[-1].values) == 0
    assert abs(int(got[0].values.mean()) - 90) < 3
    assert said and all(line.startswith(f"{url}: the stream ") for line in said)
    assert all(line.endswith("; opening it again") for line in said)
    for _ in incoming:  # the server has gone
        pass
    assert said[-1] == f"{url}: the stream did not come back"


def test_what_is_no_source_is_named(tmp_path, monkeypatch):
    av = pytest.importorskip("av")
    (tmp_path / "notes.txt").write_text("no video")
    for name, reason in {"none": "no such folder, device or file", "notes.txt": "video"}.items():
        with pytest.raises(PeriscopyError, match=reason) as error:
            open_source(str(tmp_path / name))
        assert name in str(error.value)

    def forbidden(*_, **__):
        raise av.error.PermissionError(13, "Permission denied")

    monkeypatch.setattr(av, "open", forbidden)
    with pytest.raises(PeriscopyError, match="/dev/video0: no permission"):
        open_source("/dev/video0")


def test_a_function_may_fail_and_ends_with_none(said, stopped):
    shots = iter([np.full((4, 4), 9, ">u2"), np.ones((4, 4, 3)), np.ones((4, 4), complex)])
    got = [*open_source(lambda: next(shots, None)).frames(stopped, said.append)]
    assert got[0].values.shape == (4, 4, 1) and (got[0].values == 9).all()
    assert got[0].values.dtype == np.uint16 and got[1].values.size == (4, 4)
    assert len(got) == 2 and "complex" in said[0]

    def broken():
        raise RuntimeError("no camera")

    assert [*open_source(broken).frames(stopped, said.append)] == []
    assert said[-1] == "the function of frames raised RuntimeError: no camera"


@pytest.mark.parametrize("keeps", [False, True])
def test_late_items_are_dropped_and_counted_or_wait(keeps):
    place, got, free = Latest(keeps=keeps), [], Event()

    def take():
        free.wait()
        got.extend(place)

    def put():
        for k in range(10):
            place.put(k)
        place.close()

    threads = [Thread(target=each) for each in (take, put)]
    threads[1].start()
    if not keeps:
        threads[1].join()
    free.set()
    threads[0].start()
    for each in threads:
        each.join()
    assert got == ([*range(10)] if keeps else [9])
    assert place.dropped == (0 if keeps else 9)
