"""Settings for the whole suite."""

import os

# Small matrices on busy cores: OpenBLAS's threads would mostly wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
