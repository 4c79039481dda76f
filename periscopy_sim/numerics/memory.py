"""How much memory a light transport matrix needs, and whether this machine has it."""

from pathlib import Path


def transport_memory(
    pixels: int, patches: int, bytes_per_entry: float = 25, fixed: float = 0.6e9
) -> float:
    """Return the bytes that A, (pixels, patches), and what is made of it need.

    As measured: for each entry of A while the default method is fitted, A and B themselves and
    copies; beside A the renderer and a block of rows.
    """
    return fixed + bytes_per_entry * pixels * patches


def has_memory(size: float) -> bool:
    """Return whether so many bytes can be had now; True where that is not known."""
    available = available_memory()
    return available is None or size <= available


def available_memory() -> int | None:
    """Return how many bytes can be had now, no more than a container may have; None if unknown."""
    known = [_of_machine(), _of_container()]
    return min((size for size in known if size is not None), default=None)


def _of_machine() -> int | None:
    try:
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
        return 1024 * int(dict(line.split(":") for line in lines)["MemAvailable"].split()[0])
    except (KeyError, ValueError, OSError):  # of Linux alone
        return None


def _of_container(folder: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Return what cgroups (version 2) leave, without what their cache could give back."""
    try:
        limit, used, statistics = (
            (folder / f"memory.{name}").read_text("ascii") for name in ("max", "current", "stat")
        )
        cached = dict(map(str.split, statistics.splitlines())).get("inactive_file", 0)
        return int(limit) - int(used) + int(cached)
    except (ValueError, OSError):  # no container, or no limit
        return None
