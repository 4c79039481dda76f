"""What `periscopy prepare` tells of a prepared photograph."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.cli.output import say

if TYPE_CHECKING:
    from periscopy_sim.photographs.film.size import FilmAdvice
    from periscopy_sim.photographs.prepare import Prepared
    from periscopy_sim.photographs.view.fitting import FittedView

GOOD = 2.0
"""Times what clicks and a ruler allow that the marks' residual may be."""


def tell_prepared(
    found: Prepared, advice: FilmAdvice, size: tuple[int, int], *, casts: bool
) -> None:
    """Print how well the view is known, what was left out, and which film the shadows need."""
    rows, columns = found.mask.shape
    if found.view is not None:
        pixel = advice.pixel * advice.shape[0] / rows
        say(
            f"{len(found.view.marks)} marks {_fit(found.view)}; they place the scene's pixels to "
            f"{found.placement:.2f} of one ({1e3 * pixel * found.placement:.2g} mm on the wall) "
            "where it is worst"
        )
    reasons = {
        "outside of the photograph": found.outside, "by the mask": found.masked,
        "beneath tags": found.markers, "saturated": found.saturated,
    }  # fmt: skip
    told, rest = [], ~found.mask  # each pixel is told once
    for why, pixels in reasons.items():
        if count := np.count_nonzero(pixels & rest):
            told.append(f"{count} {why}")
        rest &= ~pixels
    if rest.any():
        told.append(f"{np.count_nonzero(rest)} mostly dead or hot")
    left_out = f"; left out {', '.join(told)}" if told else ""
    single = f"; {found.defects} dead or hot ones left out" if found.defects else ""
    say(
        f"{size[0]}x{size[1]} pixels averaged to {rows}x{columns}, {found.coverage:.3g} in each"
        f"{single}{left_out}"
    )
    say(_advised(advice, (rows, columns), found, casts=casts))


def _fit(view: FittedView) -> str:
    """Return how well a view fits its marks, and whether that is well."""
    from periscopy_sim.photographs.view.fitting import ASSUMED, RULER

    if not view.freedom:
        return "are as many as the view needs: nothing checks them"
    off = float(np.sqrt(np.mean(view.residuals**2)))
    on_wall = 1e3 * np.sqrt(np.mean(view.residuals_on_wall**2))
    lens = "".join(f", k{n + 1} = {k:.4g}" for n, k in enumerate(view.view.distortion))
    allowed = (
        f"{ASSUMED:g} pixels in the photograph and {1e3 * RULER:g} mm on the wall allow "
        f"({view.expected:.2f} pixels)"
    )
    judged = (
        f"as good as errors of {allowed}"
        if off <= GOOD * view.expected
        else f"more than errors of {allowed}: check the points, and the wall's flatness"
    )
    told = f"{off:.2f} pixels of the photograph ({on_wall:.2g} mm on the wall) rms"
    return f"fit to {told}, {judged}{lens}"


def _advised(advice: FilmAdvice, shape: tuple[int, int], found: Prepared, *, casts: bool) -> str:
    """Return the line that tells whether the film is as fine as the shadows need."""
    megabytes = advice.size(shape) / 1e6
    room = f"A takes {megabytes:.3g} MB" + ("" if advice.fits(shape) else ", too much here")
    if advice.step is None:
        reason = "film: the shadows are none of a mesh's edges; " if casts else "film: "
        return f"{reason}{room}"
    pixels = advice.pixels_in_step(shape)
    line = (
        f"film: {pixels:.2g} pixels in a step of the shadow ({1e3 * advice.step:.2g} mm from patch "
        f"to patch); {room}"
    )
    from periscopy_sim.photographs.film.size import PIXELS_IN_STEP, films_of_marks

    if not advice.fits(shape) or pixels >= 2 * PIXELS_IN_STEP:
        return f"{line}; coarser would do: --bin auto"
    if pixels >= PIXELS_IN_STEP or found.coverage < 4:
        return line
    for placement, advised in (
        (found.placement, "finer may show more: --bin auto"),
        (0.0, "finer would show more only with more marks, or marks further apart"),
    ):
        if advice.choose(films_of_marks(shape, found.coverage, placement)) > shape:
            return f"{line}; {advised}"
    return line


def view_record(found: Prepared) -> dict[str, Any]:
    """Return what the metadata tell of the view and of what was left out."""
    record: dict[str, Any] = {
        "pixels_left_out": int(np.count_nonzero(~found.mask)),
        "defects_left_out": found.defects,
        "coverage": found.coverage,
    }
    if found.view is not None:
        view = found.view
        record |= {
            "view_placement": found.placement,
            "view_residual_pixels": float(np.sqrt(np.mean(view.residuals**2))),
            "view_residual_metres": float(np.sqrt(np.mean(view.residuals_on_wall**2))),
            "view_distortion": " ".join(map(repr, view.view.distortion)) or "none",
            "view_homography": " ".join(map(repr, view.view.homography.ravel().tolist())),
        }
    return record
