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
coarse. XX"""


def likeliest_remedy(
    session: Session, light: Light, fitted: Any, photograph: ps.Photograph, solution: Any,
    report: "Report",
) -> str:  # fmt: skip
    """Return one sentence; empty where the scene fits.

    Patches are too coarse if a finer grid explains the misfit and the scene's numbers, moved a
    little, do not. Otherwise the likeliest cause is the scene's numbers.
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
    """Return whether a finer grid explains the misfit, and moved numbers do not."""
    from periscopy_sim.analytic.area_transport import pixel_transport
    from periscopy_sim.calibration.prior import free_parameters
    from periscopy_sim.model.residual import explained_by, residual_of
    from periscopy_sim.model.transport_operator import LARGEST_GRAM, TransportOperator

    scenario, residual = session.scenario, report.residual
    rows, columns = (2 * size for size in scenario.hidden_shape)
    transport, observation = fitted.projected_transport(), fitted.observation
    if residual is None or len(transport.Q) * (rows * columns) ** 2 > LARGEST_GRAM:
        return False
    y = fitted.corrected(photograph.values, solution)
    image = observation.mixed(solution.image).reshape(solution.image.shape)
    signal = transport.light(image.reshape(-1, 3))
    if errors := free_parameters(scenario.document):
        lights = ps.uncertain_transport(scenario, errors).lights(image, observation.mask)
        share = residual.misfit / (residual.misfit + (residual.noise_alone or 0.0) ** 2)
        if explained_by(lights, y - signal, transport) > FINER * share:
            return False
    finer = ps.load_scenario(session.path, (rows, columns), session.definitions)
    A = observation.used_transport(pixel_transport(finer))
    other = residual_of(y, signal, TransportOperator(A, transport.Q), observation.placed)
    return other.misfit < (1 - FINER) * residual.misfit
