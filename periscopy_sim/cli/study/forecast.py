"""What a long command will do, and how long it takes, printed before it does it."""

from periscopy_sim.cli.output import record, say

PLURALS = {"matrix": "matrices", "geometry": "geometries"}
"""Nouns whose plural has more than an s."""


def counted(count: int, noun: str) -> str:
    """Return a count with its noun."""
    plural = PLURALS.get(noun, f"{noun}s")
    return f"{count:,} {noun if count == 1 else plural}"


def show_parts(**numbers: int) -> None:
    """Print how many photographs, ambient lights and so on a command makes."""
    record(to_make=numbers)
    words = [counted(n, noun.replace("_", " ")) for noun, n in numbers.items() if n]
    if words:
        say(f"to make: {', '.join(words)}")


def show_time(seconds: float, *apart: str) -> None:
    """Print how long a command takes, but for what is apart."""
    record(estimated_seconds=round(seconds))
    number, unit = max(float(f"{seconds:.2g}"), 1.0), "s"
    for unit_seconds, name in ((3600, "hours"), (60, "minutes")):
        if seconds > 1.5 * unit_seconds:
            number, unit = float(f"{seconds / unit_seconds:.2g}"), name
            break
    say(" and ".join([f"about {number:g} {unit}", *apart]))
