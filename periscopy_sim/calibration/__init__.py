"""Calibration: what the ruler got wrong, estimated from the photograph alone."""
