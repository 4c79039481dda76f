import numpy as np

from periscopy_sim.cli import messages
from periscopy_sim.model.residual import Residual
from periscopy_sim.reconstruction.method import Note, Report


def test_verdict_is_one_line_of_eighty_columns():
    for diagnosis, unexplained, noise, excess, code in [
        ("fits", 0.0071, 0.007, 1.0, "fits"),
        ("fits", 0.0081, 0.007, 9.0, "nearly_fits"),
        ("fits", 0.0211, 0.007, 1.0, "image_does_not_fit"),
        ("fits", 1e-7, 1e-8, 9.0, "fits"),
        ("does_not_fit", 0.0081, 0.007, 1.0, "does_not_fit"),
        ("does_not_fit", 0.2, 0.007, 9.0, "does_not_fit"),
        ("unknown", 0.0081, 0.007, 9.0, "not_judged"),
        ("unknown", 0.01, None, None, "not_judged"),
        ("fits", 0.2, 0.007, 9.0, "unexplained"),
        (None, 0, 0, 0, "no_residual"),
    ]:
        light = np.zeros((4, 4, 3))
        residual = Residual(light, unexplained, unexplained, noise, excess, diagnosis)
        remedy = Note("better_transport", {"remedy": "areas"})
        remedies = [remedy] if code == "does_not_fit" else []
        report = Report(residual=residual if diagnosis else None, remedies=remedies)
        assert report.verdict.code == code
        assert report.is_doubted == (("fit" in code and code != "fits") or code == "unexplained")
        line = messages.verdict(report, with_remedies=True)
        assert line.endswith("Pass --model analytic.") == bool(remedies)
        assert len(line) <= 80 and "\n" not in line
