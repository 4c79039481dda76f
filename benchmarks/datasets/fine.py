"""The suite `fine`; see `benchmarks.suites`."""

from benchmarks.entry import SuiteDataset, geometries_of


class Dataset(SuiteDataset):
    """The suite's geometries."""

    name = "fine"
    parameters = geometries_of("fine")
