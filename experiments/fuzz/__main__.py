"""Fuzz every reader: photographs, hidden images, sequences, scenes, meshes, configurations.

`python -m experiments.fuzz --out DIR [--count 20000] [--seed 0]` reads sound files of every kind
and damaged ones in processes of limited memory. The reader must accept each file, or reject it by
a `PeriscopyError` of one line, within 10 s, without a warning, and without memory beyond what a
file of its size deserves. Anything else is a defect: the script counts it and keeps its files under
DIR/defects. It reads /proc, so it needs Linux.
"""

from __future__ import annotations

import json
import os
import pickle
import re
import selectors
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Self

import numpy as np
import typer

from experiments.fuzz.damage import damaged
from experiments.fuzz.sound import Case, sound_cases
from experiments.fuzz.worker import ACCEPTED, REFUSED

LONGEST = 10.0
"""Seconds that a case may take."""

START = 120.0
"""Seconds for a process's first case of a reader, a sound one: it loads libraries."""

WORKER = ("-m", "experiments.fuzz.worker")
"""How Python is to run the process that reads."""

SHARE = {"scene": 0.02, "configuration": 0.1}
"""Of the damaged cases: these readers are slow. The others share the rest."""


@dataclass(frozen=True)
class Finding:
    """What came of a case.

    Attributes
    ----------
    case
        The case.
    verdict
        Accepted, refused, or the kind of defect.
    detail
        The error's line, or what the defect is.
    seconds
        Time it took.
    """

    case: Case
    verdict: str
    detail: str
    seconds: float

    @property
    def is_defect(self) -> bool:
        """Whether it is neither accepted nor refused as it should be."""
        return self.verdict not in (ACCEPTED, REFUSED)


class Reader:
    """A process that reads cases, started again whenever a case hangs or ends it.

    Parameters
    ----------
    sound
        Cases of which one of each reader is read first.
    """

    def __init__(self, sound: Sequence[Case]) -> None:
        self._sound = {case.reader: case for case in sound}
        self._folder = TemporaryDirectory()
        self._process: subprocess.Popen[bytes] | None = None
        self._warm: set[str] = set()

    def read(self, case: Case) -> Finding:
        """Read a case; a hang or the end of the process is a finding too."""
        if self._process is None:
            self._start()
        if case.reader not in self._warm:
            self._warm.add(case.reader)
            self._ask(self._sound[case.reader], START)
        return self._ask(case, LONGEST)

    def _ask(self, case: Case, patience: float) -> Finding:
        assert self._process is not None and self._process.stdin and self._process.stdout
        content = pickle.dumps(case)
        start = time.perf_counter()
        self._process.stdin.write(len(content).to_bytes(8, "little") + content)
        self._process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(self._process.stdout, selectors.EVENT_READ)
            answered = bool(selector.select(patience))
        line = self._process.stdout.readline() if answered else b""
        seconds = time.perf_counter() - start
        if line:
            verdict, detail = json.loads(line)
            return Finding(case, verdict, detail, seconds)
        code = self._end()
        if not answered:
            return Finding(case, "hang", f"longer than {patience:g} s", seconds)
        return Finding(case, "crash", f"the process ended with {code}", seconds)

    def _start(self) -> None:
        log = Path(self._folder.name) / "output.txt"
        self._process = subprocess.Popen(
            [sys.executable, "-W", "error", *WORKER, str(log)],
            cwd=Path(__file__).parents[2],
            env={**os.environ, "TMPDIR": self._folder.name, "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._warm.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        self._folder.cleanup()

    def _end(self) -> int:
        """End the process, and give its exit status."""
        if self._process is None:
            return 0
        process, self._process = self._process, None
        try:
            process.wait(0.5)
        except subprocess.TimeoutExpired:
            process.kill()
        process.communicate()
        return process.returncode


def damaged_cases(sound: Sequence[Case], count: int, seed: int) -> Iterator[Case]:
    """Damage sound cases; each of the same seed and number is the same."""
    of_reader: dict[str, list[Case]] = {}
    for case in sound:
        of_reader.setdefault(case.reader, []).append(case)
    rest = 1 - sum(SHARE.values())
    many = sum(len(cases) for reader, cases in of_reader.items() if reader not in SHARE)
    for reader, cases in of_reader.items():
        share = SHARE.get(reader, rest * len(cases) / many)
        for k in range(round(count * share)):
            rng = np.random.default_rng([seed, len(reader), ord(reader[-1]), k])
            yield damaged(cases[k % len(cases)], cases, rng)


def fuzz(cases: Sequence[Case], sound: Sequence[Case], processes: int = 1) -> Iterator[Finding]:
    """Read cases in several processes, which first read sound ones."""

    def share(k: int) -> list[Finding]:
        with Reader(sound) as reader:
            return [reader.read(case) for case in cases[k::processes]]

    with ThreadPoolExecutor(processes) as pool:
        for findings in pool.map(share, range(processes)):
            yield from findings


def summary(findings: Sequence[Finding]) -> dict[str, Counter[str]]:
    """Count the verdicts by reader."""
    tally: dict[str, Counter[str]] = {}
    for finding in findings:
        tally.setdefault(finding.case.reader, Counter())[finding.verdict] += 1
    return tally


def keep(findings: Sequence[Finding], out: Path) -> dict[str, int]:
    """Write the files of the defects, some of each class, and count the classes."""
    classes: Counter[str] = Counter()
    for finding in findings:
        if finding.is_defect:
            what = re.sub(r"[\d.]+", "#", finding.detail)[:60]
            name = f"{finding.case.reader} {finding.verdict} {finding.case.kind}: {what}"
            classes[name] += 1
            if classes[name] <= 3:
                folder = out / "defects" / f"{len(classes):03d}-{classes[name]}"
                finding.case.write(folder / "files")
                (folder / "finding.txt").write_text(
                    f"{finding.case.reader}\n{finding.case.kind}\n{finding.verdict}\n"
                    f"{finding.detail}\n{finding.seconds:.1f} s\n",
                    "utf-8",
                )
    return dict(classes)


def main(
    out: Annotated[Path, typer.Option(help="Folder for the defects and the tally.")],
    count: Annotated[int, typer.Option(help="Damaged files.")] = 20_000,
    seed: Annotated[int, typer.Option(help="Of the damage.")] = 0,
    processes: Annotated[int, typer.Option(help="Reading at once.")] = 2,
    only: Annotated[str, typer.Option(help="Readers, separated by commas.")] = "",
) -> None:
    """Read sound and damaged files, and count the outcomes."""
    start = time.perf_counter()
    sound = sound_cases()
    chosen = set(only.split(",")) if only else {case.reader for case in sound}
    cases = [*sound, *damaged_cases(sound, count, seed)]
    findings = list(fuzz([case for case in cases if case.reader in chosen], sound, processes))
    refused = {f"{f.case.kind}: {f.detail}" for f in findings if f.case in sound and f.detail}
    classes = keep(findings, out)
    tally = {reader: dict(verdicts) for reader, verdicts in summary(findings).items()}
    record = {"tally": tally, "defects": classes, "slowest": max(f.seconds for f in findings),
              "sound but refused": sorted(refused)}  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    (out / "tally.json").write_text(json.dumps(record, indent=2) + "\n", "utf-8")
    print(json.dumps(record, indent=2))
    print(f"{len(findings)} files, {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    typer.run(main)
