"""A matrix that is streamed."""


class Blocks:
    """A matrix in blocks of three rows, which counts how often each was asked for."""

    def __init__(self, A):
        self.A = A
        self.shape = A.shape
        self.reads = 0

    def row_blocks(self):
        for start in range(0, len(self.A), 3):
            rows = slice(start, min(start + 3, len(self.A)))
            self.reads += rows.stop - rows.start
            yield rows, self.A[rows].copy()
