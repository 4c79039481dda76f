"""The suite `adversarial-light`; see `benchmarks.suites`."""

from benchmarks.entry import SuiteDataset, geometries_of


class Dataset(SuiteDataset):
    """The suite's geometries."""

    name = "adversarial-light"
    parameters = geometries_of("adversarial-light")
