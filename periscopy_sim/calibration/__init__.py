"""Scenes that calibrate themselves: what the ruler got wrong, from the photograph alone."""
