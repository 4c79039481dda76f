"""How much memory can be had."""

import psutil
import pytest

from periscopy_sim.numerics import memory


def test_available_memory_is_what_the_machine_or_its_container_leaves():
    available = memory.available_memory()
    assert 0 < available <= 1.05 * psutil.virtual_memory().available + 2**28


@pytest.mark.parametrize(
    ("limit", "expected"), [("3000\n", 3000 - 1000 + 200), ("max\n", None), (None, None)]
)
def test_container_leaves_its_limit_less_what_is_used_and_not_cached(tmp_path, limit, expected):
    if limit is not None:
        (tmp_path / "memory.max").write_text(limit)
        (tmp_path / "memory.current").write_text("1000\n")
        (tmp_path / "memory.stat").write_text("anon 700\ninactive_file 200\n")
    assert memory._of_container(tmp_path) == expected
