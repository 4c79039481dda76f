"""The suite `low-sbr`; see `benchmarks.suites`."""

from benchmarks.entry import SuiteDataset, geometries_of


class Dataset(SuiteDataset):
    """The suite's geometries."""

    name = "low-sbr"
    parameters = geometries_of("low-sbr")
