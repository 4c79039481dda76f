"""Kill the making of a data set at random moments, damage its files, and compare what comes out.

`python -m experiments.studies.dataset_kills --out DIR [--kills 50]` makes a small data set
undisturbed, then again and again with SIGKILL at random moments and, after some of them, a random
file cut short, flipped in one bit, or removed. After each kill every block that is marked finished
must hold the undisturbed bytes unless it was damaged since, and in the end all files must.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from periscopy_sim.dataset.archive.layout import read_head
from periscopy_sim.errors import DatasetError
from periscopy_sim.storage.outputs.store import MAKING, is_complete

CONFIGURATION = """
seed: 7
count: 480
hidden: 5x6
samples_per_geometry: 160
samples_per_shard: 20
clip_length: 4
scenes:
  - scene: chair
    parameters: {occluder_dx: {uniform: [-0.05, 0.05]}, resolution: 32}
hidden_images:
  - {kind: shapes}
  - {kind: text}
  - {kind: moving}
  - {kind: smooth}
ambient:
  - {kind: lamps}
  - {kind: none}
light: {kind: direct, samples: 4}
keep_background: true
"""


def main(
    out: Annotated[Path, typer.Option(help="Folder for the archives and the tally.")],
    kills: Annotated[int, typer.Option(help="Processes to kill.")] = 50,
    seed: Annotated[int, typer.Option(help="Of the moments and of the damage.")] = 0,
) -> None:
    """Kill and damage, then compare with an undisturbed run."""
    rng = np.random.default_rng(seed)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    (out / "small.yaml").write_text(CONFIGURATION, "utf-8")
    start = time.perf_counter()
    run(out, "undisturbed.zarr").wait()
    whole = time.perf_counter() - start
    expected = files_of(out / "undisturbed.zarr")
    tally: Counter[str] = Counter()
    archive = out / "killed.zarr"
    while tally["kills"] < kills:
        process = run(out, archive.name)
        try:
            process.wait(rng.uniform(0.2, 1.05) * whole)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            tally["kills"] += 1
            tally["before the first block" if not marks(archive) else "between blocks"] += 1
        check_marks(archive, expected, tally)
        if process.returncode == 0:
            tally["finished runs"] += 1
            if files_of(archive) != expected:
                tally["finished with other bytes"] += 1
            if rng.random() < 0.3:
                shutil.rmtree(archive)
        elif process.returncode != -signal.SIGKILL:
            tally[f"exits with {process.returncode}"] += 1
        for _ in range(rng.integers(3)):
            tally[f"damages: {damage(archive, rng)}"] += 1
        print(dict(tally), flush=True)
    code = run(out, archive.name).wait()
    tally["last run exits with"] = code
    tally["last run's bytes differ"] = int(files_of(archive) != expected)
    (out / "tally.json").write_text(json.dumps(dict(tally), indent=2) + "\n", "utf-8")
    print(json.dumps(dict(tally), indent=2))
    print(f"an undisturbed run: {whole:.1f} s, {len(expected)} files")


def run(folder: Path, archive: str) -> subprocess.Popen[bytes]:
    """Start the command that makes the data set."""
    command = [sys.executable, "-m", "periscopy_sim", "dataset", "small.yaml", "--out", archive]
    with (folder / f"{archive}.log").open("ab") as log:
        return subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)


def files_of(archive: Path) -> dict[str, str]:
    """Digest of each file; the lock is no part of the data."""
    return {
        str(file.relative_to(archive)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(archive.rglob("*"))
        if file.is_file() and file.name != ".lock"
    }


def marks(archive: Path) -> list[Path]:
    """List the marks of finished blocks, and not those that were being written."""
    return sorted((archive / MAKING / "finished").glob("[0-9]*.json"))


def check_marks(archive: Path, expected: dict[str, str], tally: Counter[str]) -> None:
    """Count blocks that count as finished though their bytes are not the undisturbed ones."""
    try:
        _, layout, digest = read_head(archive)
    except DatasetError:
        tally["heads missing or damaged"] += 1
        return
    found = files_of(archive)
    for mark in marks(archive):
        block = int(mark.stem)
        if not is_complete(archive, digest, layout.block(block)):
            tally["damaged blocks recognized"] += 1
            continue
        tally["finished blocks checked"] += 1
        names = [name for name in expected if name.split("/")[1:3] == ["c", str(block)]]
        names = [name for name in names if not name.startswith(("channel", "geometry_", "param"))]
        if any(found.get(name) != expected[name] for name in names):
            tally["wrong taken for right"] += 1


def damage(archive: Path, rng: np.random.Generator) -> str:
    """Cut short, flip a bit of, or remove a random file."""
    files = [
        file for file in sorted(archive.rglob("*"))
        if file.is_file() and file.name != ".lock" and file.stat().st_size
    ]  # fmt: skip
    if not files:
        return "none, there was no file"
    file = files[int(rng.integers(len(files)))]
    content = bytearray(file.read_bytes())
    match str(rng.choice(["cut", "flip", "remove"])):
        case "cut":
            file.write_bytes(content[: int(rng.integers(len(content)))])
            return "cut short"
        case "flip":
            content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
            file.write_bytes(content)
            return "one bit flipped"
    file.unlink()
    return "removed"


if __name__ == "__main__":
    typer.run(main)
