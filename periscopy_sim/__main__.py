"""Run the command line as `python -m periscopy_sim`."""

from periscopy_sim.cli import main

main()
