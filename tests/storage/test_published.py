import hashlib
import io
import re
import threading
from dataclasses import replace
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from scipy.io import savemat

import periscopy_sim as ps
from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage import published
from periscopy_sim.storage.rasters import srgb_encode
from tests.scenes.contents import contents

TRUTH = np.random.default_rng(0).uniform(0.1, 1, (29, 36, 3))
FRAME = "TestPosD11Video/frame_0.mat"
STILL = "TestPosChair/Single Pixels/image_test_top_left.mat"


def capture(**fields):
    """A file of the layout, of 252 x 252 counts: 2 in red, 4 in either green, 6 in blue."""
    image = np.tile([[2.0, 4.0], [4.0, 6.0]], (126, 126))
    stream = io.BytesIO()
    savemat(stream, {"image": image, "shutter_speed": 0.5, **fields})
    return stream.getvalue()


FILES = {
    FRAME: capture(iterations=4.0),
    STILL: capture(averaged_iterations=2.0, ground_truth=np.rint(255 * srgb_encode(TRUTH))),
}


class Server(BaseHTTPRequestHandler):
    """Serves `files` and counts requests; cuts the first answer for each name of `cut`."""

    def __init__(self, files, cut, requests, *arguments):
        self.files, self.cut, self.requests = files, cut, requests
        super().__init__(*arguments)

    def do_GET(self):
        name = self.path.removeprefix("/").replace("%20", " ")
        self.requests.append(name)
        content = self.files.get(name, b"")
        self.send_response(200 if content else 404)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        half = name in self.cut
        self.cut.discard(name)
        self.wfile.write(content[: len(content) // 2] if half else content)

    def log_message(self, *_):
        pass


@pytest.fixture
def server(monkeypatch, tmp_path):
    """The files that are served, the names cut once, the name of each request."""
    files, cut, requests = dict(FILES), set(), []
    http = ThreadingHTTPServer(("127.0.0.1", 0), partial(Server, files, cut, requests))
    thread = threading.Thread(target=http.serve_forever, daemon=True)
    thread.start()
    known = published.published_sets()["saunders2019-chair"]
    sums = {name: hashlib.sha256(content).hexdigest() for name, content in FILES.items()}
    small = replace(known, url=f"http://127.0.0.1:{http.server_port}/", files=sums)
    monkeypatch.setattr(published, "published_sets", lambda: {"small-set": small})
    monkeypatch.setattr("pooch.core.time.sleep", lambda _: None)
    monkeypatch.setenv("PERISCOPY_DATA", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    yield files, cut, requests
    http.shutdown()
    http.server_close()
    thread.join()


def test_set_is_downloaded_once(server):
    folder = ps.fetch("small-set")
    assert contents(folder) == FILES
    assert ps.fetch("small-set") == folder
    assert server[2] == [FRAME, STILL]


def test_cut_download_is_tried_again(server):
    server[1].update(FILES)
    assert contents(ps.fetch("small-set")) == FILES
    assert server[2] == [FRAME, FRAME, STILL, STILL]


def test_damaged_file_is_rejected_by_name_and_not_kept(server, tmp_path):
    server[0][STILL] = FILES[STILL][:-1] + b"!"
    with pytest.raises(PeriscopyError, match=STILL):
        ps.fetch("small-set")
    assert contents(tmp_path / "cache" / "small") == {FRAME: FILES[FRAME]}


@pytest.mark.usefixtures("server")
def test_capture_is_read_as_photograph_and_hidden_image(tmp_path):
    folder = ps.fetch("small-set")
    for name, exposure in ((FRAME, 2), (STILL, 1)):
        np.savez(tmp_path / "capture.npz", **published.read_capture(folder / name))
        values = ps.read_photograph(tmp_path / "capture.npz", (126, 126)).values
        np.testing.assert_allclose(values / [2, 4, 6], 1 / exposure, rtol=1e-9)
    hidden = ps.read_hidden_image(tmp_path / "capture.npz", (29, 36))
    np.testing.assert_allclose(hidden, TRUTH, atol=0.01)


def test_unknown_set_is_rejected():
    with pytest.raises(PeriscopyError, match="saunders2019-chair"):
        ps.fetch("saunders-chair")


def test_registry_names_files_once_and_fits_shipped_scenes():
    sets = published.published_sets()
    names = [name for each in sets.values() for name in each.files]
    assert len(set(names)) == len(names)
    for each in sets.values():
        assert all(re.fullmatch("[0-9a-f]{64}", digest) for digest in each.files.values())
        xml = find_scene(each.scene).read_text("utf-8")
        assert all(f'<default name="{name}"' in xml for name in each.parameters)


def colours(folder, values, **settings):
    """Three MATLAB 7.3 files of one photograph, (rows, columns, 3), columns first as MATLAB has."""
    h5py = pytest.importorskip("h5py")
    paths = [folder / f"room{end}.mat" for end in published.COLOURS]
    for path, channel in zip(paths, np.moveaxis(values, 2, 0), strict=True):
        with h5py.File(path, "w", userblock_size=512) as file:
            file.create_dataset("im", data=channel.T, **settings)
    return paths


def test_three_files_are_one_photograph_in_colour(tmp_path):
    values = np.random.default_rng(0).random((5, 4, 3))
    paths = colours(tmp_path, values, compression="gzip")
    np.testing.assert_allclose(published.read_colours(paths), values**2.2)
    known = published.published_sets()["czajkowski2024-doorway"]
    small = replace(known, files={path.name: "" for path in reversed(paths)})
    ((name, arrays),) = small.arrays(tmp_path)
    assert name == "room"
    np.testing.assert_allclose(arrays["photograph"], values**2.2)


def test_colours_of_another_layout_are_rejected_by_name(tmp_path):
    for fault, words in [
        (lambda file: file.clear(), "MATLAB"),
        (lambda file: file.create_group("im"), "MATLAB"),
        (lambda file: file.create_dataset("im", data=np.zeros((2, 2, 2))), "shape"),
        (lambda file: file.create_dataset("im", data=[["a"]], dtype="S1"), "MATLAB"),
        (lambda file: file.create_dataset("im", data=np.zeros((5, 5))), "shape"),
    ]:
        h5py = pytest.importorskip("h5py")
        paths = colours(tmp_path, np.ones((4, 5, 3)))
        with h5py.File(paths[1], "r+") as file:
            del file["im"]
            fault(file)
        with pytest.raises(PhotographError, match=f"room_green.*{words}"):
            published.read_colours(paths)


def test_square_pictures_of_a_file_are_read_by_their_names(tmp_path):
    values = np.random.default_rng(0).random((3, 3))
    file = tmp_path / "corner.mat"
    savemat(file, {"a": values, "b": values.reshape(-1, 1, order="F"), "rate": 2.0, "name": "x"})
    arrays = published.read_arrays(file)
    assert {*arrays} == {"a", "b"}
    for each in arrays.values():
        np.testing.assert_array_equal(each[..., 0], values)
    savemat(file, {"a": values[:2]})
    with pytest.raises(PhotographError, match="no square picture"):
        published.read_arrays(file)
