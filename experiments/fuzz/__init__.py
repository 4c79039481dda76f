"""Fuzzing of every reader with damaged and hostile files."""
