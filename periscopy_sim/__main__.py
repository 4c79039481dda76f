"""Run the command line as `python -m periscopy_sim`, or as `periscopy`."""

from __future__ import annotations


def main() -> None:
    """Run the command line; end in one line where it is interrupted before it has begun."""
    try:
        from periscopy_sim.cli import main as command
    except KeyboardInterrupt:
        import sys

        print("periscopy: error: interrupted; nothing was written", file=sys.stderr)
        raise SystemExit(130) from None
    command()


if __name__ == "__main__":
    main()
