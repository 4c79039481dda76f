"""Run the command line as `python -m periscopy_sim`, or as `periscopy`."""


def main() -> None:
    """Run the command line; end in one line where it is interrupted before it has begun."""
    try:
        try:
            from periscopy_sim.cli import main as command
        except KeyboardInterrupt:
            import sys

            print("periscopy: error: interrupted; no file is half-written", file=sys.stderr)
            raise SystemExit(130) from None
        command()
    finally:
        # An interrupt that came out of the exec or eval of a string, of which `dataclass` makes
        # its methods, counts as unhandled, though it was caught: at its end `python -m` kills
        # itself by SIGINT, whatever the exit code. Only the next string that is run clears that.
        exec("")


if __name__ == "__main__":
    main()
