"""What can be known of a scene before it is used, and of an image after: notes and remedies."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from periscopy_sim.analytic.area_transport import has_areas
from periscopy_sim.calibration.prior import distant_parameters, scene_covariance
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.measurement import OWN_SHARE
from periscopy_sim.methods import Name, entry_of, label_of
from periscopy_sim.model import spectral_basis
from periscopy_sim.model.fit import PRECISION, relative_noise
from periscopy_sim.numerics import Array, Mask, machine, validation
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.method import Note, Report, StillMethod
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS, RAYS
from periscopy_sim.rendering import survey, variant
from periscopy_sim.rendering.photograph import bounced_light, detail_light
from periscopy_sim.rendering.shadow_rays import RenderedTransport
from periscopy_sim.view import Geometry

DIFFUSE = "diffuse", "null"
"""Materials whose reflected light, if any, is the same in all directions."""


SIGNIFICANT = 3.0
"""Standard deviations of the noise of all pixels' mean that a white surface's light exceeds."""

LEAST_LIGHT = 0.25
"""Mean of P A f of a white f, by other rays, below which it is A's grain that has rank. By 16 rays
it is 0.7 to 1 on chair, plate, plant and corner, 0.04 to 0.19 on the doorway."""


def check(scenario: Geometry, method: Name | None = None) -> list[Note]:
    """Return notes on what a scene and its A lack; see `Scenario.check`."""
    notes, of = list[Note](), {"scene": scenario.path.name}
    if method is not None:
        notes += check_memory(scenario, method)
    if lights := scenario.scene.lights:
        names = ", ".join(f"'{name}'" for name in lights)
        notes.append(Note("other_lights", {**of, "names": names}))
    reflecting = scenario.scene.reflecting.items()
    if glossy := {name: each for name, each in reflecting if each not in DIFFUSE}:
        materials = ", ".join(dict.fromkeys(glossy.values()))
        notes.append(Note("glossy", {**of, "names": ", ".join(glossy), "materials": materials}))
    if doubt := survey.shadow_doubt(scenario):
        notes.append(Note("shadows", {**of, "doubt": doubt}))
    return notes


def check_memory(scenario: Geometry, method: Name = "", *views: Geometry) -> list[Note]:
    """Reject what needs more memory than there is; note what a fine grid of patches needs.

    `views` are other views of the scene, which the method is fitted to, too.
    """
    pixels, patches = scenario.transport_shape
    entry = entry_of(method) or METHODS[DEFAULT]
    rows = pixels + sum(each.transport_shape[0] for each in views)
    fitted = 2 * rows if views else rows
    own, seconds = 0.0, 0.0
    if method and entry.patterns:
        own, seconds = spectral_basis.cost(fitted, patches)
    # As measured: beside A, what is made of it and copies, the renderer and a block of rows.
    needed = 0.6e9 + own + (entry.bytes_per_entry if method else 4) * fitted * patches
    available = machine.available_memory()
    if available is not None and needed > available:
        raise PeriscopyError(
            f"{rows} pixels x {patches} patches need {needed / 1e9:.1f} GB of memory, of "
            f"{available / 1e9:.1f} GB; average pixels, or take fewer patches"
        )
    if not own or patches <= spectral_basis.MOST_PATTERNS:
        return []
    values = {"patches": patches, "memory": needed / 1e9, "seconds": seconds}
    return [Note("fine_grid", {"method": label_of(method), **values})]


def check_error(
    scenario: Geometry, origin: Mapping[str, Any], noise: float | None, name: str = "A"
) -> list[Note]:
    """Note that the error of an A exceeds a third of the photographs' noise, and what lowers it.

    The origin is that of `plan`, or a record of it.
    """
    error, model = origin["transport_error"], origin["model"]
    if noise is None or error is None or error <= max(OWN_SHARE * noise, PRECISION):
        return []
    by_rays = "areas" if has_areas(scenario) else "rays"
    remedy = {"analytic": "size", "file": "file"}.get(model, by_rays)
    way = validation.WAYS.get(model, model)
    percent = {"error": 100 * error, "noise": 100 * noise}
    more = {"remedy": remedy, "more_rays": 4 * (origin["samples"] or RAYS)}
    return [Note("transport_error", {"name": name, "model": way, **percent, **more})]


def check_light(
    scenario: Geometry,
    origin: Mapping[str, Any],
    A: Array,
    noise: float | None,
    method: Name,
    *,
    by_default: bool,
) -> list[Note]:
    """Note the error of A, and surfaces hardly seen; see `Scenario.check_light`."""
    entry = entry_of(method)
    has_ridge = by_default and entry is not None and entry.rays  # for P, which grain lends rank
    notes = [] if has_ridge else check_error(scenario, origin, noise)
    white = A.sum(axis=0, dtype=np.float64) / (A.sum(dtype=np.float64) or 1.0)
    least = SIGNIFICANT * (noise or 0) / np.sqrt(len(A))
    for name, part in scenario.hidden.slices.items():
        if (share := float(white[part].sum())) < least:
            notes.append(Note("hardly_seen", {"name": name, "percent": 100 * share}))
    return notes


def check_rank(scenario: Any, fitted: StillMethod[Any], pixels: Mask | None) -> None:
    """Reject P of an A of some rays whose rank is but that of their grain: other rays prove it.

    `pixels` are those that the photograph uses; None stands for all.
    """
    P = getattr(fitted, "preconditioner", None)
    samples = fitted.plan.samples if fitted.plan else None
    if samples is None or P is None:  # an A without grain
        return
    others = RenderedTransport(scenario, samples, seed=scenario.seed + 1)
    rows = np.flatnonzero(np.ones(scenario.photograph_shape) if pixels is None else pixels)
    kept = float(P.apply(others.white(rows)).mean())
    if kept < LEAST_LIGHT:
        raise PeriscopyError(
            f"scene '{scenario.path}': A has almost no rank beside the grain of {samples} rays, in "
            f"which P loses {100 * min(1 - kept, 1):.0f} % of a white image; use the method "
            f"{DEFAULT}, or more rays"
        )


def with_patches_tried(
    scenario: Geometry, report: Report, fitted: StillMethod[Any], images: Mapping[str, Array]
) -> Report:
    """Return a doubted report with what smaller patches would explain, by areas."""
    residual, fit = report.residual, fitted.fit
    if residual is None or residual.unexplained_by_any is None or not report.is_doubted:
        return report
    if not has_areas(scenario):
        return report
    light = np.asarray(fit.used(detail_light(scenario, images)).T[None], np.float64)
    residual = residual.tried("patches", light, fit)
    return replace(report, residual=residual, numbers={**report.numbers, **residual.numbers()})


def check_bounces(
    scenario: Geometry,
    fitted: StillMethod[Any],
    images: Mapping[str, Array],
    photograph: Photograph,
    seed: int,
) -> list[Note]:
    """Note that light of the images that bounces, and no ambient light of B, exceeds noise.

    A direct A lacks it. Images are in the channels of the fit's planes.
    """
    noise, fit = relative_noise(photograph), fitted.fit
    if not (noise and variant.is_vectorized()) or scenario.scene.transparent:
        return []
    planes = fit.used(bounced_light(scenario, images, seed)).T
    rest = np.sqrt(np.mean(fit.project_out(planes) ** 2, axis=1))
    mean = fit.vectors(photograph.values).mean(axis=0)
    ratio = float((rest / mean).max()) / noise
    return [Note("bounces", {"scene": scenario.path.name, "ratio": ratio})] if ratio > 1 else []


def remedies_of(
    scenario: Geometry, report: Report, fitted: StillMethod[Any], photograph: Photograph
) -> tuple[Note, ...]:
    """Return what lowers the residual of this photograph, or where to look."""
    known = scene_covariance(scenario.document)
    if known and not known.trusted:
        return (Note("distrusted_scene", {"names": distant_parameters(scenario.document)}),)
    is_image = report.verdict.code in ("unexplained", "image_does_not_fit")
    if is_image and fitted.name != DEFAULT:
        return (Note("default_method"),)
    residual = report.residual
    if residual is None or not report.is_doubted:
        return ()
    plan = fitted.plan
    excess = check_error(scenario, plan.origin, relative_noise(photograph)) if plan else []
    if excess and 2 * plan.error**2 > residual.misfit:  # the larger part of it
        return (Note("better_transport", excess[0].values),)
    is_detail_tried = "patches" in residual.explained_by  # untried detail can look like paint
    untried = {
        "patches": True, "numbers": known is None,
        "paint": is_detail_tried and not photograph.monitor_off,
    }  # fmt: skip
    remedies = [name for name in residual.remedies if untried[name]] or ["look"]
    return tuple(map(Note, remedies))
