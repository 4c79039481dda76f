"""The way that a user goes, with commands that answer what they are told to."""

from experiments.laboratories import overall
from experiments.laboratories.stages import Parameter, Way
from experiments.report import Verdict


def test_overall_counts_determined_parameters_within_their_errors():
    def parameter(strays, determined):
        return Parameter("x", 0.0, 1.0 + strays * 0.1, 0.1, 1.0, determined)

    good = [parameter(k / 10, True) for k in range(19)]
    for bad, verdict in ((1, Verdict.AGREES), (2, Verdict.DIFFERS)):
        found = [*good, *[parameter(3.5, True)] * bad, parameter(9, False)]
        assert overall.confidence([Way("lamp", 0, [], found)]).verdict is verdict
