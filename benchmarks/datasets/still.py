"""The suite `still`; see `benchmarks.suites`."""

from benchmarks.entry import SuiteDataset, geometries_of


class Dataset(SuiteDataset):
    """The suite's geometries."""

    name = "still"
    parameters = geometries_of("still")
