"""How fast `periscopy watch` shows frames of 1080 x 1920 pixels, and in how much memory.

`python -m experiments.benchmarks.watch --out DIR [--seconds 60]` writes `index.html` and
`watch_speed.png`. A function returns codes of 8 bits at 30 frames a second: the chair's wall, seen
aslant, with noise. A reader takes the page's messages; then headless Chromium does, on the same
cores. It needs what `live` needs, and psutil.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from threading import Event, Thread
from typing import Annotated, Any

import numpy as np
import psutil
import typer
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from websockets.sync.client import connect

import periscopy_sim as ps
from experiments.benchmarks.live import chromium, running, visit
from experiments.benchmarks.scene import SMALL
from experiments.page import Out, one_line_errors
from experiments.report import Claim, Picture, Section, Verdict, write_page
from experiments.setting import Setting
from periscopy_sim.figures.style import COLUMN, OKABE_ITO, drawn
from periscopy_sim.live.frames import Companions, open_source
from periscopy_sim.live.watch import WatchSession
from periscopy_sim.numerics import Array
from periscopy_sim.photographs.wall_view import fit_homography, project, wall_plane
from periscopy_sim.storage.provenance import as_text, provenance
from periscopy_sim.storage.rasters import srgb_bytes

RATE, LATENCY, SECONDS = 30.0, 0.1, 20.0
"""Goals: frames a second and seconds to the pixels; how long they are measured."""

WARM_UP = 5.0
"""Seconds before: loops are compiled, and shaders."""

SIZE, CORNERS = (1080, 1920), ((430, 60), (1520, 110), (1470, 1010), (470, 960))
"""Of the frames, and columns and rows in them of the film's corners."""

SEEN = """() => {
    window.ages = [];
    new MutationObserver(() => requestAnimationFrame(() =>
        window.ages.push(Date.now() / 1000 - state.taken))).observe(
        document.querySelector("#panels img"), {attributes: true, attributeFilter: ["src"]});
}"""
"""Records the age of each picture when the browser draws it."""


def watch(setting: Setting, seconds: float = SECONDS) -> Section:
    """Watch the camera for some seconds by a reader, then by a browser; write what was measured."""
    scene, before = ps.load_scenario("chair", SMALL), os.getloadavg()
    pictures, points = frames_of(scene)
    process, latencies, resident = psutil.Process(), list[float](), list[tuple[float, float]]()
    arrivals = list[float]()

    def record(_: Any, progress: Any) -> None:
        arrivals.append(time.time() - progress.latency)
        session.gate.publish(taken=arrivals[-1])

    def shown(*given: Any, **named: Any) -> None:
        show(*given, **named)
        latencies.append(1000 * (time.time() - arrivals[-1]))

    with (
        chromium() as browser,
        WatchSession(
            open_source(camera(pictures)), scene, "noise-aware", lambda _: "", lambda _: [],
            companions=Companions(points), count=30, record=record,
        ) as session,
        running(session),
    ):  # fmt: skip
        show, session.show = session.show, shown  # type: ignore[method-assign]
        with reader(session.gate.url):
            while session.shown < RATE * WARM_UP:
                if session.fault is not None:
                    raise session.fault
                time.sleep(0.1)
            latencies.clear()
            begun, cpu, dropped = time.time(), process.cpu_times(), session.dropped
            while (now := time.time() - begun) < seconds:
                resident.append((now, process.memory_info().rss / 2**20))
                time.sleep(min(1.0, seconds))
            spent, shown_in = process.cpu_times(), np.array(latencies)
            dropped = session.dropped - dropped
        page = visit(session, browser)
        page.wait_for_timeout(1000 * WARM_UP)
        page.evaluate(SEEN)
        page.wait_for_timeout(1000 * SECONDS)
        ages = np.array(page.evaluate("window.ages"))
    picture = setting.out / "watch_speed.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    command = ["python", "-m", "experiments.benchmarks.watch", f"--seconds={seconds:g}"]
    draw(picture, shown_in, np.array(resident), command)
    middle, late = np.percentile(shown_in, [50, 95])
    used = (spent.user + spent.system - cpu.user - cpu.system) / len(shown_in)
    rates, pixels = (len(shown_in) / seconds, len(ages) / SECONDS), float(np.median(ages))
    return Section(
        "watch",
        "Frames of 1080 x 1920 pixels on the page, chair, 29 x 36 patches",
        claims=[
            Claim(
                "frames ready for the page, without a browser",
                f"{RATE:g} a second", f"{rates[0]:.1f}", Verdict.of(rates[0] > 0.95 * RATE),
                f"{seconds:g} s, camera and laboratory on {os.cpu_count()} cores; load average "
                f"{before[0]:.1f} before it began; {dropped} frames dropped.",
            ),
            Claim(
                "from the arrival of a frame to its message, median; 95 %", "",
                f"{middle:.1f}; {late:.1f} ms", Verdict.MEASURED,
            ),
            Claim(
                "frames shown by a browser on the same cores",
                f"{RATE:g} a second", f"{rates[1]:.1f}", Verdict.of(rates[1] > 0.95 * RATE),
            ),
            Claim(
                "from the arrival of a frame to its pixels there, median",
                f"at most {LATENCY:g} s", f"{pixels:.3f} s", Verdict.of(pixels <= LATENCY),
            ),
            Claim(
                "processor time a frame, without a browser", "", f"{1000 * used:.0f} ms",
                Verdict.MEASURED, "Camera, laboratory and reader, in one process.",
            ),
        ],
        pictures=[Picture(picture, "Without a browser: latencies, and memory over time.")],
    )  # fmt: skip


def draw(path: Path, latencies: Array, memory: Array, command: Sequence[str]) -> None:
    """Draw a histogram of latencies, (n,) in ms, beside memory, (n, 2) in s and MB.

    The picture's metadata name the command.
    """
    with drawn(path, as_text(provenance(None, command=command))) as figure:
        figure.set_size_inches(COLUMN, 1.8)
        left, right = figure.subplots(1, 2)
        end = 1.05 * max(1000 * LATENCY, latencies.max())
        left.hist(latencies, bins=np.arange(0.0, end), color=OKABE_ITO[0])
        for name, percent, style in (("median", 50, "-"), ("95 %", 95, "--")):
            value = np.percentile(latencies, percent)
            label = f"{name}: {value:.0f}"
            left.axvline(value, color=OKABE_ITO[1], linestyle=style, linewidth=0.8, label=label)
        for mark in (1000 / RATE, 1000 * LATENCY):
            left.axvline(mark, color="0.5", linestyle=":", linewidth=0.8)
        left.set(xlabel="latency (ms)", ylabel="frames", xticks=[0, 33, 100])
        handles = left.get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper left", ncols=2)
        right.plot(memory[:, 0] / 60, memory[:, 1], color=OKABE_ITO[0], linewidth=0.7)
        right.set(xlabel="time (min)", ylabel="memory (MB)", ylim=(0, 1.1 * memory[:, 1].max()))


@contextmanager
def reader(url: str) -> Iterator[None]:
    """Take a page's messages, as a browser does, and drop them."""
    stopped = Event()

    def read() -> None:
        origin: Any = url.rsplit("/", 2)[0]
        with connect(url.replace("http", "ws"), origin=origin, max_size=None) as socket:
            while not stopped.is_set():
                socket.recv()

    thread = Thread(target=read, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join(10)


def frames_of(scene: ps.Scenario, number: int = 6) -> tuple[list[NDArray[np.uint8]], ps.WallPoints]:
    """Return frames of a camera that sees the wall aslant, and points of the wall in them."""
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
    random = np.random.default_rng(0)
    noisy = (light * (1 + random.normal(0, 0.02, light.shape)) for _ in range(number))
    frames = [srgb_bytes(each) for each in noisy]
    marked = np.array([[10, 10], [116, 10], [116, 116], [10, 116], [63, 20], [20, 70]], float)
    on_wall, frame = project(plane.film, marked), plane.frame
    positions = frame.center + on_wall[:, :1] * frame.across + on_wall[:, 1:] * frame.up
    return frames, ps.WallPoints(project(to_pixels, marked), positions)


def camera(frames: list[NDArray[np.uint8]]) -> Callable[[], NDArray[np.uint8]]:
    """Return a function that returns frames in turn, `RATE` a second."""

    def paced() -> Iterator[NDArray[np.uint8]]:
        start = time.monotonic()
        for k in count():
            time.sleep(max(0.0, start + k / RATE - time.monotonic()))
            yield frames[k % len(frames)]

    return paced().__next__


def main(
    out: Out,
    seconds: Annotated[float, typer.Option(min=1, help="Seconds to measure.")] = SECONDS,
) -> None:
    """Measure how fast `periscopy watch` is, and draw it."""
    with one_line_errors():
        section = watch(Setting(out), seconds)
    write_page(out / "index.html", "Speed", [section], stated="asked")
    for claim in section.claims:
        print(f"{claim.what}: {claim.measured}. {claim.reason}")


if __name__ == "__main__":
    typer.run(main)
