"""The suite `wrong-geometry`; see `benchmarks.suites`."""

from benchmarks.entry import SuiteDataset, geometries_of


class Dataset(SuiteDataset):
    """The suite's geometries."""

    name = "wrong-geometry"
    parameters = geometries_of("wrong-geometry")
