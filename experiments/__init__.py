"""Experiments, each runnable alone from the repository's root: `python -m experiments.NAME`."""
