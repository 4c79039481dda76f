"""Find the parameters of a scene that explain photographs best."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from periscopy_sim.analytic.area_transport import ways_to
from periscopy_sim.calibration import prior, trust
from periscopy_sim.calibration.problem import CalibrationProblem
from periscopy_sim.calibration.resolution_level import Candidate, ResolutionLevel
from periscopy_sim.calibration.result import Calibration, Parameter, Rival
from periscopy_sim.calibration.search import Search
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.hidden import Sizes
from periscopy_sim.numerics import Array, Image
from periscopy_sim.photograph import Photograph, of_one_wall
from periscopy_sim.rendering.load import load_geometry
from periscopy_sim.rendering.survey import shadow_doubt
from periscopy_sim.scene import CAMERA, Scene


def calibrate(
    photograph: Photograph | Image | Sequence[Photograph | Image],
    scene: str | Path | Scene,
    hidden: Sizes,
    free: prior.Free | None = None,
    *,
    shown: Sequence[Image | Mapping[str, Image]] = (),
    parameters: Mapping[str, str | float] | None = None,
    uncertain: Mapping[str, float] | None = None,
    camera: str = CAMERA,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Find the values of a scene's parameters that explain photographs best.

    The ambient light comes from afar, a gain over the wall is smooth (`ResolutionLevel`), and the
    parameters have a normal prior about the measured values. A hidden image that is not known is
    smooth (`evidence`).

    Parameters
    ----------
    photograph
        A `Photograph`, or (rows, columns, C), linear, of any unit; or several such photographs of
        one laboratory. The pixels used are those that all masks leave; the light of all photographs
        with the monitor off is projected out. Photographs with a colour matrix are unmixed first:
        their channels' noise is then correlated, which the standard errors leave out.
    scene
        A Mitsuba XML file, the name of a shipped scene, or a scene that was loaded.
    hidden
        (R, C) of the hidden image; of several surfaces a mapping of such by id. The search uses at
        most 36 patches along a side of each.
    free
        Names of the ``<default>``s to find, or a mapping of them to the standard deviations of
        their measured values, None for the one that the scene declares. By default, all whose error
        the scene declares as the ``<default>`` ``NAME_error``, except those in `uncertain`.
    shown
        (R, C, P) pictures that the monitor showed, linear, one for each of the first photographs;
        of several surfaces mappings of such by id. A known picture determines the place of the
        scene, and a colour matrix.
    parameters
        Values of ``<default>``s: measured values of free ones; others keep them.
    uncertain
        Standard errors of ``<default>``s that keep their value, independent of each other. They
        only enlarge the errors of the free ones ("consider" analysis: Bierman, Factorization
        Methods for Discrete Sequential Estimation, 1977, chapter 8). By default, those that the
        scene declares of all that is not free.
    camera
        Id of the sensor that photographed.
    seed
        Seed of the draws.
    progress
        Called with the fraction done, 1 at last.

    Returns
    -------
    Calibration
        Look at `Calibration.trusted` first.

    Raises
    ------
    SceneError
        If a parameter or its error is unknown, no shadow is in view where the search starts, or the
        scene has no closed form (`analytic_transport`).
    PhotographError
        If photographs are not of the camera's size or fewer than the shown pictures, or a shown
        picture is black or given beside a colour matrix.
    """
    scenario = load_geometry(scene, hidden, parameters, camera=camera)
    photographs = of_one_wall(photograph, scenario.photograph_shape)
    if not 0 < len(photographs) >= len(shown):
        raise PhotographError(
            f"shown pictures: {len(shown)}, photographs: {len(photographs)}; give one of each"
        )
    if shown and photographs[0].colour_matrix is not None:
        raise PhotographError("a shown picture determines the colour matrix: leave one of them out")
    errors = prior.free_parameters(scenario.document, free, uncertain or {})
    names, deviations = tuple(errors), np.array(list(errors.values()))
    centers = prior.ruled_values(scenario.document, names)
    held = prior.uncertain_parameters(scenario.document, names, uncertain)
    scenario = scenario.at(**dict(zip(names, centers.tolist(), strict=True)))
    ways_to(scenario)
    if doubt := shadow_doubt(scenario):
        raise SceneError(
            f"scene '{scenario.path}': {doubt}; calibration starts from shadows: "
            "add an occluder, or move one into the view"
        )
    unmixed = [each.unmixed() for each in photographs]
    problem = CalibrationProblem(scenario, names, centers, deviations, held, unmixed, shown)
    # Products this small gain less from threads than these cost by waiting for each other on a busy
    # machine; and the result does not depend on the number of cores.
    with threadpool_limits(1):
        return calibrated(problem, seed, progress or (lambda _: None))


def calibrated(
    problem: CalibrationProblem,
    seed: int,
    progress: Callable[[float], None],
    search: Search | None = None,
) -> Calibration:
    """Search, estimate the errors, and keep the measured values unless others explain more."""
    fine, names = problem.fine(), problem.names
    whole = problem.joint()
    search = search or Search(problem.coarse(), fine, whole, seed, progress)
    level, end = search.best(search.starts())
    gain, κ = end.point[len(names) :], end.temperature
    measured = level.candidate(np.append(problem.centers, gain))
    gained = measured.objective_at(κ) - end.objective
    moved = trust.is_significant(gained, trust.determined_count(end, len(names)))
    best, rivals = (end, search.rivals) if moved else (measured, [])
    whole_odds = 1 + sum(odds for _, odds in rivals)
    values = fine.values(best.point)
    # The errors are those of all numbers together, also of the uncertain ones, at the search's end.
    point = np.concatenate([fine.values(end.point), whole.centers[len(names) :], gain])
    whole = whole.with_misfit(whole.candidate(point))
    joint = whole.look(whole.candidate(point), κ)
    statistical, total, correlation, moves = trust.standard_errors(
        problem, joint, sum(search.spread)
    )
    colours = trust.colour_matrix(problem, end, joint) if problem.pictures else (None, None)
    known = trust.determined_count(joint, len(names))
    if not moved:  # what the photograph says is of the discarded end
        statistical = total = problem.errors
        correlation, moves, κ, known = np.eye(len(names)), 0 * moves, 1.0, np.inf
    distances = (values - problem.centers) / problem.errors
    start, kept = (level.plainly(each.point) for each in (measured, best))
    misfit = trust.misfits(kept, problem.camera_noise(fine.scene.pixels.size))
    reasons = trust.doubts(names, distances, known, misfit)
    columns = problem.centers, values, statistical, total, problem.errors
    scale = float(np.sqrt(np.mean(np.concatenate([g.light.ravel() for g in fine.groups]) ** 2)))
    before, after = (
        np.concatenate([e.noise for e in look.explanations]) / scale for look in (start, kept)
    )
    first = slice(problem.photographs[0].channels)
    residual_before, residual = (
        _picture(fine, np.hstack([e.residual for e in look.explanations])[:, first] / scale)
        for look in (start, kept)
    )
    progress(1.0)
    return Calibration(
        parameters=tuple(
            Parameter(name, *(float(number) for number in row), trusted=not reasons)
            for name, *row in zip(names, *columns, strict=True)
        ),
        uncertain=problem.uncertain,
        moves=moves,
        correlation=correlation,
        path=search.path,
        noise_before=before,
        noise=after,
        residual_before=residual_before,
        residual=residual,
        gain=_picture(fine, fine.gain(best.point) - 1) + 1,
        overdispersion=κ,
        moved=moved,
        colour_matrix=colours[0],
        colour_errors=colours[1],
        doubts=reasons,
        rivals=tuple(
            Rival(
                dict(zip(names, fine.values(each.point).tolist(), strict=True)), odds / whole_odds
            )
            for each, odds in rivals
        ),
        images=tuple(
            _last_image(problem, each) for each in (end, *(r for r, _ in rivals)) if rivals
        ),
    )


def _last_image(problem: CalibrationProblem, candidate: Candidate) -> Any:
    """Return the hidden image of the last photograph, not shown, as a candidate explains it."""
    light = candidate.explanations[-1].lights[:, -problem.photographs[-1].channels :]
    return problem.hidden.image(np.maximum(light, 0))


def _picture(level: ResolutionLevel, values: Image) -> Array:
    """Return values of a level's pixels, (M, ...), as (rows, columns, ...), 0 in others."""
    pixels = level.scene.pixels
    picture = np.zeros((*pixels.shape, *values.shape[1:]))
    picture[pixels] = values
    return picture
