"""Experiments, each runnable alone from the repository's root: see each one's docstring."""
