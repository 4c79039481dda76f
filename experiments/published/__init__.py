"""The published measurements, all of them, as one page."""
