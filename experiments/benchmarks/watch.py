"""How fast `periscopy watch` shows frames of 1080 x 1920 pixels, as headless Chromium shows them.

A camera of this machine serves MJPEG at 30 frames a second: the chair's wall, seen aslant, with
noise. It needs what `live` needs, PyAV and psutil. The browser takes its part of the cores.
"""

from __future__ import annotations

import io
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any

import numpy as np
import psutil
from PIL import Image
from scipy.ndimage import map_coordinates

import periscopy_sim as ps
from experiments.benchmarks.live import PATIENCE, chromium, running
from experiments.benchmarks.scene import SMALL
from experiments.report import Claim, Section, Verdict
from experiments.setting import Setting
from periscopy_sim.live.frames import open_source
from periscopy_sim.live.pictures import Choice
from periscopy_sim.live.preparation import Companions
from periscopy_sim.live.session import LiveSession
from periscopy_sim.live.stream import Stream
from periscopy_sim.photographs.wall_view import fit_homography, project, wall_plane
from periscopy_sim.storage.formats.srgb import srgb_bytes

RATE, LATENCY, SECONDS = 30.0, 0.1, 20.0
"""Goals: frames a second and seconds to the pixels; how long they are measured."""

SIZE, CORNERS = (1080, 1920), ((430, 60), (1520, 110), (1470, 1010), (470, 960))
"""Of the frames, and columns and rows in them of the film's corners."""

SEEN = """() => {
    window.ages = [];
    new MutationObserver(() => requestAnimationFrame(() =>
        window.ages.push(Date.now() / 1000 - state.taken))).observe(
        document.querySelector("#panels img"), {attributes: true, attributeFilter: ["src"]});
}"""
"""Records the age of each picture when the browser draws it."""


def watch(_: Setting) -> Section:
    """Watch the camera for some seconds."""
    scene, before = ps.load_scenario("chair", SMALL), os.getloadavg()
    pictures, points = frames_of(scene)
    process = psutil.Process()
    offered = (), ["noise-aware"], lambda _: "", lambda _: []
    with camera(pictures) as url, chromium() as browser:
        stream = Stream(open_source(url), scene, Companions(points), 30, print)
        with LiveSession(scene, Choice({}, ""), *offered, stream=stream) as session:
            show = stream.show

            def stamped(pictures: Any, progress: Any, lines: list[str]) -> None:
                session.page.gate.publish(taken=time.time() - progress.latency)
                show(pictures, progress, lines)

            stream.show = stamped
            with running(session):
                page = browser.new_page(viewport={"width": 1200, "height": 800})
                page.set_default_timeout(1000 * PATIENCE)
                page.goto(session.page.gate.url)
                page.get_by_text("full pictures").wait_for()
                page.wait_for_timeout(5000)  # loops are compiled, and shaders
                count, cpu, memory = stream.shown, process.cpu_times(), process.memory_info().rss
                page.evaluate(SEEN)
                page.wait_for_timeout(1000 * SECONDS)
                ages = np.array(page.evaluate("window.ages"))
                shown, spent = stream.shown - count, process.cpu_times()
                grown = (process.memory_info().rss - memory) / 2**20
    rate, latency = len(ages) / SECONDS, float(np.median(ages))
    used = (spent.user + spent.system - cpu.user - cpu.system) / max(shown, 1)
    return Section(
        "watch",
        "Frames of 1080 x 1920 pixels on the page, chair, 29 x 36 patches",
        claims=[
            Claim(
                "frames shown", f"{RATE:g} a second", f"{rate:.1f}", Verdict.of(rate > 0.95 * RATE),
                f"{SECONDS:g} s, browser, camera and laboratory on {os.cpu_count()} cores; load "
                f"average {before[0]:.1f} before it began; {stream.dropped} frames dropped.",
            ),
            Claim(
                "from the arrival of a frame to its pixels, median",
                f"at most {LATENCY:g} s", f"{latency:.3f} s", Verdict.of(latency <= LATENCY),
            ),
            Claim(
                "processor time a frame, without the browser's", "", f"{1000 * used:.0f} ms",
                Verdict.MEASURED, "Camera and laboratory, in one process.",
            ),
            Claim("memory gained", "", f"{grown:.0f} MB", Verdict.MEASURED),
        ],
    )  # fmt: skip


def frames_of(scene: ps.Scenario, count: int = 6) -> tuple[list[bytes], ps.WallPoints]:
    """Return JPEG frames of a camera that sees the wall aslant, and points of the wall in them."""
    n, plane = scene.photograph_shape[0], wall_plane(scene)
    corners = np.array([[0, 0], [n, 0], [n, n], [0, n]], float)
    to_pixels = fit_homography(corners, np.array(CORNERS, float))
    row, column = np.mgrid[: SIZE[0], : SIZE[1]].reshape(2, -1) + 0.5
    places = project(np.linalg.inv(to_pixels), np.stack([column, row], axis=1))[:, ::-1] - 0.5
    image = ps.read_hidden_image(ps.find_image("mushroom"), SMALL).reshape(-1, 3)
    signal = scene.channel_gain * (ps.transport(scene) @ image)
    ambient = ps.point_light_backgrounds(scene)[:, 100:101]
    wall = (0.15 * (signal / signal.mean() + ambient / ambient.mean())).reshape(n, n, 3)
    light = np.stack(
        [map_coordinates(wall[..., c], places.T, order=1, mode="nearest") for c in range(3)], -1
    ).reshape(*SIZE, 3)
    random, files = np.random.default_rng(0), list[bytes]()
    for _ in range(count):
        file = io.BytesIO()
        noisy = srgb_bytes(light * (1 + random.normal(0, 0.02, light.shape)))
        Image.fromarray(noisy).save(file, "JPEG", quality=92)
        files.append(file.getvalue())
    marked = np.array([[10, 10], [116, 10], [116, 116], [10, 116], [63, 20], [20, 70]], float)
    on_wall, frame = project(plane.film, marked), plane.frame
    positions = frame.center + on_wall[:, :1] * frame.across + on_wall[:, 1:] * frame.up
    return files, ps.WallPoints(project(to_pixels, marked), positions)


@contextmanager
def camera(files: list[bytes]) -> Iterator[str]:
    """Serve JPEG files in turn as MJPEG, `RATE` a second; yield the address."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace;boundary=b")
            self.end_headers()
            start = time.monotonic()
            try:
                for k in range(10**9):
                    time.sleep(max(0.0, start + k / RATE - time.monotonic()))
                    file = files[k % len(files)]
                    head = f"--b\r\nContent-Type: image/jpeg\r\nContent-Length: {len(file)}\r\n\r\n"
                    self.wfile.write(head.encode() + file + b"\r\n")
            except OSError:  # the watcher has gone
                return

        def log_message(self, *_: object) -> None:
            """Print nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()
