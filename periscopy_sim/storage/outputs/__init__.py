"""Outputs that are complete or absent, locked, resumed, and say where they come from."""
