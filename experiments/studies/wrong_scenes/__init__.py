"""Calibrations of scenes all of whose numbers are wrong at once, by what a ruler errs."""
