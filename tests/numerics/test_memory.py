import psutil

from periscopy_sim.numerics import memory


def test_available_memory_is_what_the_machine_or_its_container_leaves():
    available = memory.available_memory()
    assert 0 < available <= 1.05 * psutil.virtual_memory().available + 2**28
