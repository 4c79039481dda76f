"""The likeliest remedy where a scene does not fit its photograph."""

from typing import TYPE_CHECKING, Any

import periscopy_sim as ps
from periscopy_sim.cli.light import Light
from periscopy_sim.cli.messages import sentence
from periscopy_sim.cli.output import progress
from periscopy_sim.cli.session import Session

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Report

FINER = 0.75
"""Fraction of the misfit that a grid of twice the rows and columns explains where patches are too
coarse: 0.88 to 1 of chairs with patches 1.5 to 3 times too coarse, 0.33 to 0.5 of a chair 10 to
20 mm off. It also explains 0.95 of a chair 4 mm off, which looks alike."""


def likeliest_remedy(
    session: Session, light: Light, fitted: Any, photograph: ps.Photograph, solution: Any,
    report: "Report",
) -> str:  # fmt: skip
    """Return one sentence; empty where the scene fits.

    Patches are too coarse if a finer grid explains the misfit. Otherwise the likeliest cause is the
    scene's numbers.
    """
    from periscopy_sim.analytic.area_transport import has_areas
    from periscopy_sim.calibration.scene_covariance import scene_covariance

    if report.verdict.code == "unexplained":
        return sentence("default_method")
    if report.verdict.code != "does_not_fit":
        return ""
    if scene_covariance(session.scenario.document) is not None:
        return sentence("look")
    if not has_areas(session.scenario):
        return sentence("measure")
    rows, columns = (2 * size for size in session.scenario.hidden_shape)
    with progress("looking for the cause of the misfit"):
        if light.most_bounces == 1 and _is_coarse(session, fitted, photograph, solution, report):
            return sentence("patches", rows=rows, columns=columns)
    return sentence("calibrate")


def _is_coarse(
    session: Session, fitted: Any, photograph: ps.Photograph, solution: Any, report: "Report"
) -> bool:
    """Return whether a finer grid explains the misfit."""
    from periscopy_sim.analytic.area_transport import pixel_transport
    from periscopy_sim.model.residual import residual_of
    from periscopy_sim.model.transport_operator import LARGEST_GRAM, TransportOperator

    scenario, residual = session.scenario, report.residual
    rows, columns = (2 * size for size in scenario.hidden_shape)
    transport, observation = fitted.projected_transport(), fitted.observation
    pixels, patches = len(transport.Q), rows * columns
    if residual is None or 2 * patches > pixels or pixels * patches**2 > LARGEST_GRAM:
        return False
    y = fitted.corrected(photograph.values, solution)
    signal = transport.light(observation.mixed(solution.image))
    finer = ps.load_scenario(session.path, (rows, columns), session.definitions)
    A = observation.used_transport(pixel_transport(finer))
    other = residual_of(y, signal, TransportOperator(A, transport.Q), observation.placed)
    return other.misfit < (1 - FINER) * residual.misfit
