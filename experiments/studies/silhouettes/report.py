"""The page, the table and the files of all cases that there are."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.report import Claim, Picture, Section, Table, Verdict, write_page
from experiments.studies.silhouettes.figure import draw_cases
from experiments.studies.silhouettes.outcome import Outcome
from periscopy_sim.storage.outputs.staging import staged_file

TITLE = "Silhouettes of occluders nobody measured"

LARGEST_LOSS = 1.0
"""dB, registered, between the image by a mask whose cells are all found and by the true one."""

WRONG = 0.9
"""Part of cells shared below which a mask should not be trusted."""


def write_report(
    out: Path, outcomes: Sequence[Outcome], introduction: str, provenance: Mapping[str, str]
) -> Section:
    """Write `index.html`, `silhouettes.csv`, `.json` and the figures; return what they say.

    The figure of all cases is `silhouettes`, that of the rendered ones `silhouettes_rendered`.
    """
    rendered = [outcome for outcome in outcomes if outcome.sbr is not None]
    if rendered:
        draw_cases(out, "silhouettes_rendered", rendered)
    section = Section(
        name="silhouettes",
        title=TITLE,
        text=introduction,
        claims=list(_claims(outcomes)),
        pictures=[Picture(draw_cases(out, "silhouettes", outcomes), CAPTION)],
        tables=[_table(outcomes)],
    )
    rows = [numbers_of(outcome) for outcome in outcomes]
    with (
        staged_file(out / "silhouettes.csv") as staged,
        staged.open("w", encoding="utf-8", newline="") as file,
    ):
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    with staged_file(out / "silhouettes.json") as staged:
        held = {
            "claims": [vars(claim) for claim in section.claims],
            "cases": [{**row, **_masks(o)} for row, o in zip(rows, outcomes, strict=True)],
            "provenance": dict(provenance),
        }
        staged.write_text(json.dumps(held, indent=1, ensure_ascii=False) + "\n", "utf-8")
    write_page(out / "index.html", TITLE, [section], provenance=provenance, stated="wanted")
    return section


CAPTION = (
    "Masks as one sees them who faces the wall; orange: the outline of the true one, of a chair or "
    "a frame in the middle's light; grey: cells whose shadow the photograph does not show. Below "
    "them, opaque cells shared of those of either. Images as they fit the truth best after a shift "
    "and one factor for each channel, where it is known where on the monitor it stood; PSNR as it "
    "stands / registered."
)


def numbers_of(outcome: Outcome) -> dict[str, Any]:
    """Return a case's line of the table, by the columns' names."""
    agreed = outcome.shared
    decibels = {
        f"{kind}_{name}": None if found is None else round(found[k], 3)
        for name, found in (
            ("found", outcome.decibels(outcome.found_image)),
            ("flat", outcome.decibels(outcome.flat_image)),
            ("true", outcome.decibels(outcome.true_image)),
        )
        for k, kind in enumerate(("psnr", "registered"))
    }
    return {
        "case": outcome.name,
        "image": outcome.image,
        "sbr": outcome.sbr,
        "cells": "{}x{}".format(*outcome.opaque.shape),
        "patches": "{}x{}".format(*outcome.found_image.shape[:2]),
        "shared": round(agreed.standing, 4),
        "shared_after_shift": round(agreed.shifted, 4),
        "shift_down": agreed.down,
        "shift_right": agreed.right,
        "unexplained_percent": round(100 * outcome.unexplained, 4),
        "unexplained_without_mask_percent": round(100 * outcome.unexplained_open, 4),
        "times_noise": round(outcome.overdispersion, 2),
        "numbers_told": round(outcome.told, 1),
        "cells_seen": int(outcome.seen.sum()),
        **decibels,
        "trusted": outcome.trusted,
        "doubts": "; ".join(outcome.doubts),
        "processor_seconds": round(outcome.seconds, 1),
    }


def told(outcome: Outcome) -> str:
    """Return a case in a line."""
    of = numbers_of(outcome)
    return (
        f"{outcome.name}: {_shares(of)} of its cells shared; {of['times_noise']:.1f} times noise "
        f"left; {_decibels(of, 'found')} dB by the mask found, {_decibels(of, 'flat')} by the true "
        f"one's cells, {_decibels(of, 'true')} by the true one (as it stands / registered); "
        f"{_trust(of)}; {of['processor_seconds']:.0f} processor seconds"
    )


def _shares(of: Mapping[str, Any]) -> str:
    """Return the part of cells that are shared, and after which shift more are."""
    standing, moved = of["shared"], of["shared_after_shift"]
    if moved <= standing:
        return f"{standing:.2f}"
    return f"{standing:.2f} ({moved:.2f} {of['shift_down']:+d} down, {of['shift_right']:+d} right)"


def _decibels(of: Mapping[str, Any], name: str) -> str:
    standing, registered = (of[f"{kind}_{name}"] for kind in ("psnr", "registered"))
    return "no truth" if standing is None else f"{standing:.1f} / {registered:.1f}"


def _trust(of: Mapping[str, Any]) -> str:
    return "trusted" if of["trusted"] else f"not trusted: {of['doubts']}"


def _masks(outcome: Outcome) -> dict[str, list[str]]:
    """Return the mask found as rows of text."""
    return {"opaque": ["".join("#" if c else "." for c in row) for row in outcome.opaque]}


def _claims(outcomes: Sequence[Outcome]) -> Iterator[Claim]:
    whole = [o for o in outcomes if _of_cells(o)]
    if whole:
        exact = [o for o in whole if o.shared.standing == 1]
        least = min(whole, key=lambda o: o.shared.standing)
        yield Claim(
            "rendered masks of the search's cells, each of whose cells is found",
            "all",
            f"{len(exact)} of {len(whole)}",
            Verdict.of(len(exact) == len(whole)),
            f"least shared: {least.name}, {least.shared.standing:.2f}",
        )
        losses = {o.name: _loss(o) for o in whole}
        worst = max(losses, key=lambda name: losses[name])
        yield Claim(
            "the image by such a mask below that by the true one, registered, at most",
            f"{LARGEST_LOSS} dB",
            f"{losses[worst]:.2f} dB",
            Verdict.of(losses[worst] <= LARGEST_LOSS),
            worst,
        )
    wrong = [o for o in outcomes if o.shared.shifted < WRONG]
    believed = [o.name for o in wrong if o.trusted]
    yield Claim(
        f"masks that share less than {WRONG:.0%} after the best shift, and are trusted",
        "none",
        f"{len(believed)} of {len(wrong)}",
        Verdict.of(not believed),
        ", ".join(believed),
    )


def _of_cells(outcome: Outcome) -> bool:
    """Return whether a rendered mask's outline is that of cells."""
    rows, columns = outcome.opaque.shape
    blocks = outcome.outline.reshape(rows, len(outcome.outline) // rows, columns, -1)
    whole = blocks.max(axis=(1, 3)) == blocks.min(axis=(1, 3))
    return outcome.sbr is not None and bool(whole.all())


def _loss(outcome: Outcome) -> float:
    of = numbers_of(outcome)
    return float(of["registered_true"] - of["registered_found"])


def _table(outcomes: Sequence[Outcome]) -> Table:
    rows = []
    for outcome in outcomes:
        of = numbers_of(outcome)
        rows.append(
            (
                of["case"],
                of["image"],
                "real" if of["sbr"] is None else f"{of['sbr']:g}",
                of["cells"],
                of["patches"],
                _shares(of),
                f"{of['unexplained_percent']:.2f} %",
                f"{of['times_noise']:.1f}",
                _decibels(of, "found"),
                _decibels(of, "flat"),
                _decibels(of, "true"),
                "yes" if of["trusted"] else of["doubts"],
                f"{of['processor_seconds']:.0f}",
            )
        )
    return Table(
        "Opaque cells shared by the mask found and the true one, of those of either, as they stand "
        "(and after the shift by whole cells that is best). PSNR, dB, as it stands / registered: "
        "of the image by the mask found, by the true occluder's outline cut into the same cells, "
        "and by the true occluder.",
        (
            "case", "image", "SBR", "cells", "patches", "shared", "unexplained",
            "times noise at the worst scale", "by the mask found", "by the true one's cells",
            "by the true one", "trusted", "processor seconds",
        ),
        rows,
    )  # fmt: skip
