"""`periscopy calibrate --silhouette`: the form of an occluder nobody measured."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from periscopy_sim.cli import inputs
from periscopy_sim.cli import options as arguments
from periscopy_sim.cli.output import Stopwatch, progress, say, say_written, warn_boxed, write_json
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.numerics.percentages import percentages
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.outputs.provenance import as_text
from periscopy_sim.storage.outputs.staging import spare_inputs, staged_file

if TYPE_CHECKING:
    from periscopy_sim.calibration.silhouette.result import Silhouette

DOUBTED = (
    "Look at the picture: a silhouette that looks like nothing is nothing. Move the plane in which "
    "it is sought (-D), draw its rectangle closer, or ask for fewer --cells or smaller patches."
)
"""What to do with a silhouette that is not to be trusted."""


def refuse_others(given: Mapping[str, Any]) -> None:
    """Refuse options, by their names, that a silhouette is not found by."""
    for name, value in given.items():
        if value:
            raise PeriscopyError(
                f"--silhouette finds a form, and all numbers stay; leave {name} out, and calibrate "
                "the scene that it writes"
            )


def find_silhouette(
    photo: Path,
    scene: str,
    hidden: str,
    out: Path,
    shape: str,
    cells: str | None,
    *,
    background: list[Path] | None,
    mask: Path | None,
    seed: int,
    define: list[str] | None,
) -> None:
    """Find the silhouette of a shape; write a scene that has it, its mesh, JSON and a picture."""
    from periscopy_sim.figures.silhouette import draw_silhouette
    from periscopy_sim.photograph import blackened

    arguments.require_suffix(out, ".xml", "the scene")
    path, given = find_scene(scene), arguments.parse_definitions(define)
    size = None if cells is None else arguments.parse_size(cells)
    record, mesh = out.with_suffix(".json"), _mesh(out, shape)
    picture = out.with_name(f"{out.stem}_silhouette.png")
    outputs = [out, mesh, record, picture]
    timed = Stopwatch()
    with ExitStack() as stack:
        spare_inputs(outputs, (photo, path, *(background or []), mask))
        with timed("load the scene"), progress("loading the scene"):
            from periscopy_sim.calibration.silhouette.plane import mask_plane
            from periscopy_sim.calibration.silhouette.recover import recover_silhouette
            from periscopy_sim.calibration.silhouette.scene import (
                local_coordinates,
                write_masked_scene,
            )

            scenario = inputs.load(scene, hidden, define)
            mask_plane(scenario, shape)
            local_coordinates(path, shape, given)
        staged = [stack.enter_context(staged_file(file)) for file in outputs]
        used = inputs.read_mask(mask, scenario)
        taken = inputs.read_photograph(photo, scenario, used)
        dark = inputs.read_backgrounds(background, scenario, used)
        defects = inputs.look_for_defects(taken.values, used, str(photo))
        used = defects.used
        with timed("find the silhouette"), progress("finding the silhouette") as report:
            found = recover_silhouette(
                taken.values,
                path,
                arguments.parse_size(hidden),
                shape,
                size,
                parameters=given,
                backgrounds=dark,
                mask=used,
                seed=seed,
                progress=report,
            )
        for k, answer in enumerate((found, *found.others), 1):
            file = out if k == 1 else out.with_name(f"{out.stem}_{k}.xml")
            here, its_mesh = staged[:2]
            if k > 1:
                more = [file, _mesh(file, shape)]
                spare_inputs(more, (photo, path, *(background or []), mask))
                here, its_mesh = (stack.enter_context(staged_file(each)) for each in more)
                outputs += more
            write_masked_scene(
                path, answer, given, here, its_mesh, _mesh(file, shape).name, _remark(answer)
            )
        provenance = inputs.provenance_of(scenario, seed)
        summary = {
            "photograph": str(photo),
            "scene": str(path),
            "hidden_shape": scenario.hidden_shape,
            **inputs.mask_record(mask, used),
            "backgrounds": list(dark),
            "warnings": [*taken.warnings, *defects.warnings, *found.doubts],
            **_told(found),
            "others": [_told(other) for other in found.others],
            "seconds": timed.seconds,
            "provenance": provenance,
        }
        write_json(staged[2], summary)
        draw_silhouette(staged[3], blackened(taken.values, used), found, as_text(provenance))
    _say(found)
    say_written(*outputs)
    if found.doubts:
        warn_boxed("this silhouette is not to be trusted", found.doubts, DOUBTED)


def _mesh(scene: Path, shape: str) -> Path:
    """Return the file of a scene's mesh."""
    return scene.with_name(f"{scene.stem}_{shape}.ply")


def _remark(found: Silhouette) -> str:
    """Return what the scene's file says of where its mask is from."""
    doubts = "; ".join(found.doubts)
    told = f": NOT TO BE TRUSTED: {doubts}" if doubts else ""
    return f"'{found.name}' is a silhouette, found by periscopy calibrate --silhouette{told}"


def _told(found: Silhouette) -> dict[str, Any]:
    """Return a silhouette as it is written to JSON."""
    return {
        "shape": found.name,
        "trusted": not found.doubts,
        "doubts": found.doubts,
        "rectangle": {
            "corner": found.plane.corner,
            "across": found.plane.across,
            "down": found.plane.down,
        },
        "opaque": ["".join("#" if cell else "." for cell in row) for row in found.opaque],
        "cells_seen": int(found.seen.sum()),
        "numbers_told": found.told,
        "unexplained_open": found.unexplained_open,
        "unexplained": found.unexplained,
        "unexplained_partly_open": found.unexplained_partly,
        "between_cells": found.between,
        "overdispersion": found.overdispersion,
        "starts": found.starts,
        "starts_agreeing": found.agreeing,
        "evidence": found.evidence,
    }


def _say(found: Silhouette) -> None:
    """Print what the mask looks like and how far it is to be believed."""
    for row in found.opaque:
        say("  " + "".join("##" if cell else " ." for cell in row))
    say(
        f"of {found.opaque.size} cells the photograph shows the shadows of {found.seen.sum()}, and "
        f"tells about {found.told:.0f} numbers of them"
    )
    size = "{}x{}".format(*found.residual.shape[:2])
    without, with_it = percentages(found.unexplained_open, found.unexplained)
    say(f"unexplained: {without} % of the photograph ({size}) without it, {with_it} % with it")
    say("silhouette and image may both be shifted, against each other")
