import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from periscopy_sim.numerics import machine
from periscopy_sim.numerics.machine import core_count, ranges

ROOT = Path(__file__).parents[2]


def _printed(script):
    command = [sys.executable, "-c", script]
    return subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=ROOT, timeout=90
    ).stdout


FOUR_CORES = """
import threading, time
from periscopy_sim.numerics import machine
machine.core_count = lambda: 4
"""


def test_calls_overlap_and_those_within_a_thread_do_not_wait_for_themselves():
    # Passed only when four calls wait at once.
    script = """
barrier = threading.Barrier(4, timeout=20)
print(sorted(machine.in_parallel(lambda _: barrier.wait(), range(4))))
outer = lambda x: sum(machine.in_parallel(lambda y: x * y, range(5)))
print(machine.in_parallel(outer, range(50)) == [10 * x for x in range(50)])
"""
    assert _printed(FOUR_CORES + script) == "[0, 1, 2, 3]\nTrue\n"


def test_the_first_failure_propagates_and_the_threads_survive():
    script = """
def fail(x):
    if x >= 3:
        raise ArithmeticError(f"item {x}")
    return x
try:
    machine.in_parallel(fail, range(8))
except ArithmeticError as error:
    print(error)
print(machine.in_parallel(fail, range(3)))
"""
    assert _printed(FOUR_CORES + script) == "item 3\n[0, 1, 2]\n"


def test_cores_are_those_that_the_process_may_use():
    if not hasattr(os, "sched_getaffinity"):
        pytest.skip("this system has no processor affinity")
    script = (
        "import os; from periscopy_sim.numerics.machine import core_count; "
        "os.sched_setaffinity(0, [min(os.sched_getaffinity(0))]); print(core_count())"
    )
    assert _printed(script) == "1\n"
    assert core_count() == len(os.sched_getaffinity(0))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_starts_threads_of_its_own():
    # Also from one of the threads, which in the child is the only one.
    script = """
import os, signal, sys, warnings
from periscopy_sim.numerics import machine
warnings.simplefilter("ignore")  # newer Pythons discourage forking with threads
machine.core_count = lambda: 2
square = lambda x: x * x
assert machine.in_parallel(square, range(9)) == [x * x for x in range(9)]
def forked(_):
    child = os.fork()
    if child == 0:
        signal.alarm(20)
        here = machine.threading.current_thread()
        works = machine.in_parallel(square, range(9)) == [x * x for x in range(9)]
        workers = machine.in_parallel(lambda _: machine.threading.current_thread(), range(9))
        os._exit(0 if works and here not in workers else 3)
    return os.waitpid(child, 0)[1]
statuses = [forked(0), *machine.in_parallel(forked, range(2))]
print(statuses)
"""
    assert _printed(script) == "[0, 0, 0]\n"


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 8, 100, 1001])
def test_ranges_cover_everything_once_in_parts_of_nearly_equal_size(count, monkeypatch):
    monkeypatch.setattr(machine, "core_count", lambda: 4)
    parts = ranges(count)
    assert [n for start, stop in parts for n in range(start, stop)] == list(range(count))
    sizes = [stop - start for start, stop in parts]
    assert all(size > 0 for size in sizes)
    assert max(sizes, default=0) - min(sizes, default=0) <= 1
    assert len(parts) <= 16


def test_only_a_few_are_computed_ahead_of_who_takes_them():
    """Four threads' worth, one more, and the one that followed."""
    script = """
called = []
results = machine.ahead(called.append, range(100))
next(results)
for end in (time.sleep, lambda _: results.close()):
    end(0.05)
    time.sleep(0.05)
    print(len(called) <= 6)
"""
    assert _printed(FOUR_CORES + script) == "True\nTrue\n"


def test_results_computed_ahead_come_in_order_with_an_error_in_its_place():
    results = machine.ahead(lambda k: 10 // (k - 2), range(5))
    assert [next(results), next(results)] == [-5, -10]
    with pytest.raises(ZeroDivisionError):
        next(results)


def test_available_memory_is_what_the_machine_or_its_container_leaves():
    available = machine.available_memory()
    assert 0 < available <= 1.05 * psutil.virtual_memory().available + 2**28


def test_reported_progress_never_falls():
    seen = []
    report = machine.rising(seen.append)
    for done in (0.1, 0.5, 0.3, 0.6):
        report(done)
    assert seen == [0.1, 0.5, 0.5, 0.6]
    machine.rising(None)(0.5)
