import sys

import pytest

from experiments.fuzz.__main__ import Reader, damaged_cases, fuzz
from experiments.fuzz.sound import Case, sound_cases
from experiments.fuzz.worker import ACCEPTED, REFUSED

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the fuzzer reads /proc")


@pytest.fixture(scope="module")
def sound():
    return sound_cases()


def defects(findings):
    return [
        f"{finding.case.reader}, {finding.case.kind}: {finding.verdict} {finding.detail[:200]}"
        for finding in findings
        if finding.is_defect
    ]


@pytest.mark.thorough
def test_sound_files_are_accepted_and_a_few_hundred_damaged_ones_are_no_trouble(sound):
    kept = [case for case in sound if case.reader != "scene"]
    cases = [*kept, *(c for c in damaged_cases(sound, 500, seed=3) if c.reader != "scene")]
    findings = list(fuzz(cases, sound))
    assert not defects(findings)
    rejected = [f.case.kind for f in findings[: len(kept)] if f.verdict != ACCEPTED]
    assert rejected == ["multi-part exr"]
    assert sum(f.verdict == REFUSED for f in findings) > 200


TROUBLE = {
    "raise KeyError('a\\nb')": "exception",
    "warnings.warn('careful')": "warning",
    "os._exit(3)": "crash",
    "time.sleep(60)": "hang",
    "bytearray(b'x') * (900 << 20)": "memory",
    "raise PeriscopyError('fine')": REFUSED,
    "return [np.array([np.nan])]": "values",
    "return []": ACCEPTED,
}


@pytest.mark.parametrize(("code", "verdict"), TROUBLE.items())
def test_every_kind_of_trouble_is_told(code, verdict, monkeypatch, tmp_path):
    """A reader that misbehaves, in a worker of its own."""
    script = (
        "import os, sys, time, warnings, numpy as np\n"
        "from experiments.fuzz import worker as fuzz_worker\n"
        "from periscopy_sim.errors import PeriscopyError\n"
        f"def trouble(path):\n    {code}\n    return []\n"
        "def reader(path):\n"
        "    return [] if path.name == 'sound' else trouble(path)\n"
        "fuzz_worker.readers = lambda: {'photograph': reader}\n"
        "fuzz_worker.main()\n"
    )
    (tmp_path / "worker.py").write_text(script)
    monkeypatch.setattr("experiments.fuzz.__main__.WORKER", (str(tmp_path / "worker.py"),))
    if verdict == "hang":
        monkeypatch.setattr("experiments.fuzz.__main__.LONGEST", 2.0)
    monkeypatch.setenv("PYTHONPATH", ".")
    sound = Case("photograph", "kind", {"sound": b""})
    with Reader([sound]) as reader:
        assert reader.read(Case("photograph", "kind", {"hostile": b""})).verdict == verdict
        assert reader.read(sound).verdict == ACCEPTED
