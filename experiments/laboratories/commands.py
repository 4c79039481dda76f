"""The package's commands, run as a user runs them, in a process of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SECONDS = 3600


class CommandError(RuntimeError):
    """A command ended with another exit code than 0; the message is its last line."""


def periscopy(*words: object) -> str:
    """Run `periscopy`; return what it said.

    Raises
    ------
    CommandError
        If it failed.
    """
    command = [sys.executable, "-m", "periscopy_sim", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=False)
    said = done.stdout + done.stderr
    if done.returncode:
        raise CommandError(f"periscopy {words[0]}: {(said.splitlines() or ['no word'])[-1]}")
    return said


@dataclass(frozen=True)
class User:
    """What a user has of a laboratory, and where his results go.

    Attributes
    ----------
    folder
        Of the laboratory.
    hidden
        Rows and columns of the hidden image, as ``--hidden`` takes them.
    black
        The camera's black level.
    out
        Folder of results.
    """

    folder: Path
    hidden: str
    black: int
    out: Path

    def prepare(self, photograph: str, scene: Path, name: str, *, points: bool) -> Path:
        """Bring a photograph to a scene's film; return the EXR file, its mask lies beside."""
        out = self.out / name / "wall.exr"
        out.parent.mkdir(parents=True, exist_ok=True)
        rectify = ["--points", self.folder / "points.csv"] if points else []
        mask = ["--mask", self.folder / "poster.png"]
        file = self.folder / photograph
        periscopy(
            "prepare", file, "--scene", scene, "--black", self.black, *mask, *rectify, "--out", out
        )
        return out

    def calibrate(
        self, photograph: Path, scene: Path, backgrounds: Sequence[Path], name: str
    ) -> tuple[Path, dict[str, Any]]:
        """Calibrate what a scene declares as uncertain; return the new scene and the report."""
        # Beside the scene that it comes from, so that its meshes are found.
        out = scene.with_name(f"{scene.stem}_{name}.xml")
        periscopy("calibrate", *self._given(photograph, scene, backgrounds), "--out", out)
        report: dict[str, Any] = json.loads(out.with_suffix(".json").read_text("utf-8"))
        return out, report

    def reconstruct(
        self, photograph: Path, scene: Path, backgrounds: Sequence[Path], name: str
    ) -> dict[str, Any]:
        """Reconstruct; return the summary."""
        out = self.out / name / "picture"
        truth = ["--truth", self.folder / "truth" / "hidden.png"]
        given = self._given(photograph, scene, backgrounds)
        periscopy("reconstruct", *given, *truth, "--out", out)
        summary: dict[str, Any] = json.loads((out / "summary.json").read_text("utf-8"))
        return summary

    def _given(self, photograph: Path, scene: Path, backgrounds: Sequence[Path]) -> list[object]:
        mask = photograph.with_name("wall_mask.png")
        off = [word for file in backgrounds for word in ("--monitor-off", file)]
        return [photograph, "--scene", scene, "--hidden", self.hidden, "--mask", mask, *off]
