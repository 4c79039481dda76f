"""Calibration of the present frames in a process of its own, which does not delay the frames."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread, current_thread
from typing import Any

import numpy as np

from periscopy_sim.calibration.calibrated_scene import write_copy
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.page import Page
from periscopy_sim.live.stream import Stream
from periscopy_sim.photograph import Photograph

NICENESS = 10
"""Of the process: frames come first."""

ERROR = "periscopy: error: "
"""Begin of the line by which a command fails."""

IDLE, BUSY, OFFER = "Calibrate from these frames", "Calibrating ...", "Take the calibrated values"
"""Labels of the button, by what a press does."""

DECLINE = "Keep the present values"
"""Label of the second button, which the page shows beside an offer."""


class CalibrationButton:
    """A button: a press calibrates the scene of a stream, a second one takes the values.

    `decline` drops the values instead. The calibration starts from the values that the page shows.
    """

    def __init__(self, stream: Stream, page: Page) -> None:
        self._stream, self._page = stream, page
        self._process: subprocess.Popen[str] | None = None
        self._thread: Thread | None = None
        self._offer: dict[str, float] = {}
        self._is_stopped = False
        self.label = IDLE

    def press(self) -> None:
        """Start a calibration, or take the values of the one that has ended."""
        if self.label == IDLE:
            self._set(BUSY)
            self._thread = Thread(target=self._run, daemon=True)
            self._thread.start()
        elif self.label == OFFER:
            self._set(IDLE)
            if beyond := self._page.move(self._offer):
                names = ", ".join(beyond)
                self._stream.report(f"beyond the page's range, set to its end: {names}")

    def decline(self) -> None:
        """Drop the values that are offered, and offer a new calibration."""
        if self.label == OFFER:
            self._set(IDLE)

    def stop(self) -> None:
        """End a calibration that is running, and remove its files; report nothing of it."""
        self._is_stopped = True
        if self._process is not None:
            self._process.kill()
        if self._thread is not None and self._thread is not current_thread():
            self._thread.join(1.0)

    def _set(self, label: str) -> None:
        self.label = label
        self._page.refresh()

    def _run(self) -> None:
        label = IDLE
        try:
            if (wall := self._stream.wall) is None:
                raise PeriscopyError("no frame has come yet")
            with TemporaryDirectory(prefix="periscopy-") as folder:
                record = self._calibrated(Path(folder), wall)
            self._offer = {n: float(p["value"]) for n, p in record["parameters"].items()}
            shown = ", ".join(f"{name} {value:.4g}" for name, value in self._offer.items())
            if record["doubts"]:
                shown += f" (not trusted: {'; '.join(record['doubts'])})"
            self._stream.report(f"calibrated: {shown}")
            label = OFFER
        except (PeriscopyError, OSError) as error:
            if not self._is_stopped:
                self._stream.report(f"calibration: {error}")
        finally:
            self._set(label)

    def _calibrated(self, folder: Path, wall: Photograph) -> Any:
        """Run `periscopy calibrate` on a photograph; return its record."""
        scene, photo, out = (folder / name for name in ("scene.xml", "wall.npy", "out.xml"))
        values = {name: f"{value:.9g}" for name, value in self._page.choice.values.items()}
        scenario = self._stream.scenario
        write_copy(scenario.document, values, scene)
        np.save(photo, wall.values)
        np.save(folder / "mask.npy", wall.pixels)
        sizes = scenario.hidden.shapes.items()
        options = [f"--hidden={name}={rows}x{columns}" for name, (rows, columns) in sizes]
        options += [f"--mask={folder / 'mask.npy'}", f"--camera={scenario.view.camera}"]
        for k, light in enumerate(wall.monitor_off.values()):
            np.save(folder / f"off{k}.npy", light)
            options.append(f"--monitor-off={folder / f'off{k}.npy'}")
        if wall.colour_matrix is not None:
            np.save(folder / "colours.npy", wall.colour_matrix.matrix)
            options.append(f"--colour-matrix={folder / 'colours.npy'}")
        command = [sys.executable, "-m", "periscopy_sim", "calibrate", str(photo)]
        command += [f"--scene={scene}", f"--out={out}", *options]
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            text=True, start_new_session=True,
        ) as self._process:  # fmt: skip
            if hasattr(os, "setpriority"):
                with suppress(OSError):
                    os.setpriority(os.PRIO_PROCESS, self._process.pid, NICENESS)
            complaint = self._process.communicate()[1]
        if self._process.returncode:
            errors = [line for line in complaint.splitlines() if line.startswith(ERROR)]
            raise PeriscopyError(errors[-1].removeprefix(ERROR) if errors else "it was ended")
        return json.loads(out.with_suffix(".json").read_text("utf-8"))
