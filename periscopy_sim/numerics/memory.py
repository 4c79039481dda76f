"""How much memory can be had on this machine."""

from pathlib import Path


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
