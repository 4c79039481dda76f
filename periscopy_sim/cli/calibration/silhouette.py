"""`periscopy calibrate --silhouette`: the form of an occluder nobody measured."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from periscopy_sim.cli import options as arguments
from periscopy_sim.cli.output import fixable, progress, say, say_written, warn_boxed, write_json
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.numerics.percentages import percentages
from periscopy_sim.storage.outputs.staging import spare_inputs, staged_file

if TYPE_CHECKING:
    from periscopy_sim.calibration.silhouette.result import Silhouette

DOUBTED = (
    "Look at the picture: a silhouette that looks like nothing is nothing. Show known pictures "
    "(--shown), move the plane in which it is sought (-D), draw its rectangle closer, or ask for "
    "fewer --cells."
)
"""What to do with a silhouette that is not to be trusted."""


def find_silhouette(
    session: PhotoSession,
    photos: list[Path],
    shown: list[str],
    out: Path,
    shape: str,
    cells: str | None,
    monitor_off: list[Path] | None,
    mask: Path | None,
) -> None:
    """Find the silhouette of a shape; write a scene that has it, its mesh, JSON and a picture."""
    from periscopy_sim.calibration.silhouette.plane import MaskPlane
    from periscopy_sim.calibration.silhouette.recover import recover_silhouette
    from periscopy_sim.calibration.silhouette.scene import local_coordinates, write_masked_scene
    from periscopy_sim.figures.calibration import draw_silhouette

    path, given = session.path, session.definitions
    size = None if cells is None else arguments.parse_size(cells)
    mesh = out.with_name(f"{out.stem}_{shape}.ply")
    picture = out.with_name(f"{out.stem}_silhouette.png")
    outputs = out, mesh, out.with_suffix(".json"), picture
    spare_inputs(outputs, (*photos, path, *(monitor_off or []), mask))
    MaskPlane.of(session.scenario, shape)
    local_coordinates(path, shape, given)
    with ExitStack() as stack:
        scene_file, mesh_file, json, png = (
            stack.enter_context(staged_file(file)) for file in outputs
        )
        wall = session.wall(photos[0], mask, monitor_off)
        others = [session.photograph(file, wall.mask).values for file in photos[1:]]
        images = [session.hidden_image(name) for name in shown]
        with (
            session.timed("find the silhouette"),
            fixable("--silhouette"),
            progress("finding the silhouette") as report,
        ):
            solution = recover_silhouette(
                [wall.values, *others],
                path,
                session.size,
                shape,
                size,
                shown=images,
                parameters=given,
                backgrounds=wall.monitor_off,
                mask=wall.mask,
                seed=session.seed,
                progress=report,
            )
        write_masked_scene(
            path, solution, given, scene_file, mesh_file, mesh.name, _remark(solution)
        )
        summary = {
            "photograph": str(photos[0]),
            "photographs": [str(file) for file in photos],
            "shown": shown,
            "scene": str(path),
            "hidden_shape": session.scenario.hidden_shape,
            **session.record,
            "warnings": [*session.warnings, *solution.doubts],
            **_as_record(solution),
            "seconds": session.timed.seconds,
            "provenance": session.provenance,
        }
        write_json(json, summary)
        draw_silhouette(png, wall.values, solution, session.metadata)
    _say(solution)
    say_written(*outputs)
    if solution.doubts:
        warn_boxed("this silhouette is not to be trusted", solution.doubts, DOUBTED)


def _remark(solution: Silhouette) -> str:
    """Return what the scene's file says of where its mask is from."""
    doubts = "; ".join(solution.doubts)
    warning = f": NOT TO BE TRUSTED: {doubts}" if doubts else ""
    return f"'{solution.name}' is a silhouette, found by periscopy calibrate --silhouette{warning}"


def _as_record(solution: Silhouette) -> dict[str, Any]:
    """Return a silhouette as it is written to JSON."""
    plane = solution.plane
    return {
        "shape": solution.name,
        "trusted": not solution.doubts,
        "doubts": solution.doubts,
        "rectangle": {"corner": plane.corner, "across": plane.across, "down": plane.down},
        "opaque": ["".join("#" if cell else "." for cell in row) for row in solution.opaque],
        "opacities": solution.opacities,
        "cells_seen": int(solution.seen.sum()),
        "cells_decided": solution.decided,
        "unexplained_open": solution.unexplained_open,
        "unexplained": solution.unexplained,
        "starts": solution.starts,
        "starts_agreeing": solution.agreeing,
        "evidence": solution.evidence,
    }


def _say(solution: Silhouette) -> None:
    """Print what the mask looks like and how far it is to be believed."""
    for row in solution.opaque:
        say("  " + "".join("##" if cell else " ." for cell in row))
    seen, count = solution.seen.sum(), solution.opaque.size
    say(f"of {count} cells the photograph shows the shadows of {seen}")
    size = "{}x{}".format(*solution.residual.shape[:2])
    without, with_it = percentages(solution.unexplained_open, solution.unexplained)
    say(f"unexplained: {without} % of the photograph ({size}) without it, {with_it} % with it")
    if solution.starts:
        say("silhouette and image may both be shifted, against each other")
