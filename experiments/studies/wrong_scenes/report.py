"""The page, the table and the files of all draws that there are."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.report import Claim, Picture, Section, Table, Verdict, write_page
from experiments.studies.wrong_scenes.coverage import ONE, of_draws
from experiments.studies.wrong_scenes.figure import WANTED, draw_coverage, draw_images, loss
from experiments.studies.wrong_scenes.outcome import SCENES, Outcome
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[np.float64]

LARGEST_LOSS = 1.5
"""dB between the calibrated scene's picture and the true scene's, in the median."""

AT_ONE = np.array([ONE])


def write_report(
    out: Path, outcomes: Sequence[Outcome], introduction: str, provenance: Mapping[str, str]
) -> Section:
    """Write `index.html`, `wrong_scenes.csv`, `.json` and the figures; return what they say."""
    section = Section(
        name="wrong_scenes",
        title=TITLE,
        text=introduction,
        claims=list(_claims(outcomes)),
        pictures=[
            Picture(
                draw_coverage(out, outcomes),
                "Shares of numbers and patches whose truth lies within the reported "
                "intervals, against their level; bars at 68 %: what is wanted. Grey, of "
                "numbers: where 95 % of such sets of draws would lie were all standard errors and "
                "their correlations right; of patches: the standard error, by how draws differ. "
                "Right: each draw. Registration uses the truth.",
            ),
            Picture(
                draw_images(out, outcomes),
                "Of each scene and SBR the draw of the median loss; PSNR unshifted / after the "
                "shift that fits the truth best, as the pictures are drawn, each channel "
                "multiplied by what fits best.",
            ),
        ],
        tables=[_summary(outcomes), _table(outcomes)],
    )
    rows = [numbers_of(outcome) for outcome in outcomes]
    with (
        staged_file(out / "wrong_scenes.csv") as staged,
        staged.open("w", encoding="utf-8", newline="") as file,
    ):
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    with staged_file(out / "wrong_scenes.json") as staged:
        held = {
            "claims": [vars(claim) for claim in section.claims],
            "summary": [summary_of(cell) for cell in _cells(outcomes)],
            "draws": rows,
            "numbers": [_parameters(outcome) for outcome in outcomes],
            "provenance": dict(provenance),
        }
        staged.write_text(json.dumps(held, indent=1, ensure_ascii=False) + "\n", "utf-8")
    write_page(out / "index.html", TITLE, [section], provenance=provenance, stated="wanted")
    return section


TITLE = "Scenes all of whose numbers are wrong, calibrated"


def numbers_of(outcome: Outcome) -> dict[str, Any]:
    """Return a draw's line of the table, by the columns' names."""
    distance, worst = np.abs(outcome.z), int(np.argmax(np.abs(outcome.z)))
    determined = distance[outcome.determined]
    return {
        "scene": outcome.subject,
        "sbr": outcome.sbr,
        "draw": outcome.draw,
        **{f"psnr_{name}": round(value, 3) for name, value in outcome.psnr.items()},
        **{f"registered_{name}": round(value, 3) for name, value in outcome.registered.items()},
        "numbers": len(distance),
        "within_1": int((distance < 1).sum()),
        "within_3": int((distance < 3).sum()),
        "determined": len(determined),
        "determined_within_1": int((determined < 1).sum()),
        "determined_within_3": int((determined < 3).sum()),
        "worst": outcome.names[worst],
        "worst_z": round(float(outcome.z[worst]), 2),
        "patches_within_1": _share(outcome.patch_z),
        "matched_patches_within_1": _share(outcome.matched_patch_z),
        "errors_count_the_scene": outcome.geometry,
        "moved": outcome.moved,
        "trusted": outcome.trusted,
        "doubts": "; ".join(outcome.doubts),
        "overdispersion": round(outcome.overdispersion, 2),
        "calibration_seconds": round(outcome.seconds[0], 1),
        "reconstruction_seconds": round(outcome.seconds[1], 1),
    }


def _share(z: Array) -> float:
    return round(float(np.mean(np.abs(z) < 1)), 4)


def summary_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return a cell's line of the summary: medians, and shares with errors by how draws differ."""
    first = outcomes[0]
    z, determined = (np.array([getattr(o, name) for o in outcomes]) for name in ("z", "determined"))
    shares = {
        "numbers": _one(outcomes, lambda o: o.z),
        "patches": _one(outcomes, lambda o: o.patch_z),
        "matched_patches": _one(outcomes, lambda o: o.matched_patch_z),
    }
    return {
        "scene": first.subject,
        "sbr": first.sbr,
        "draws": len(outcomes),
        **{
            f"median_{kind}_{name}": round(median(getattr(o, kind)[name] for o in outcomes), 2)
            for kind in ("psnr", "registered")
            for name in SCENES
        },
        "median_loss": round(median(map(loss, outcomes)), 2),
        **{f"{name}_within_1": share for name, share in shares.items()},
        "within_3": round(float(np.mean(np.abs(z) < 3)), 4),
        "determined": int(determined.sum()),
        "determined_within_1": int((np.abs(z[determined]) < 1).sum()),
        "determined_within_3": int((np.abs(z[determined]) < 3).sum()),
        "trusted": sum(o.trusted for o in outcomes),
        "median_calibration_seconds": round(median(o.seconds[0] for o in outcomes), 1),
        "median_reconstruction_seconds": round(median(o.seconds[1] for o in outcomes), 1),
    }


def median(values: Any) -> float:
    """Return the median of an iterable's numbers."""
    return float(np.median(list(values)))


def _one(
    outcomes: Sequence[Outcome], z_of: Callable[[Outcome], Array]
) -> tuple[float, float | None]:
    """Return the share within one standard error and its standard error, None of a single draw."""
    mean, error = of_draws(outcomes, z_of, AT_ONE)
    return round(float(mean[0]), 4), None if np.isnan(error[0]) else round(float(error[0]), 4)


def _percent(share: float, error: float | None) -> str:
    return f"{share:.0%}" + ("" if error is None else f" ± {error:.0%}")


def _cells(outcomes: Sequence[Outcome]) -> list[list[Outcome]]:
    """Return the draws of each scene and SBR."""
    keys = dict.fromkeys((outcome.subject, outcome.sbr) for outcome in outcomes)
    return [[o for o in outcomes if (o.subject, o.sbr) == key] for key in keys]


def _parameters(outcome: Outcome) -> dict[str, Any]:
    columns = "true_values", "start", "ruler_errors", "values", "standard_errors", "determined"
    parameters = {
        name: dict(zip(columns, row, strict=True))
        for name, row in zip(
            outcome.names,
            np.array([getattr(outcome, c) for c in columns]).T.tolist(),
            strict=True,
        )
    }
    return {"scene": outcome.subject, "sbr": outcome.sbr, "draw": outcome.draw, "told": parameters}


def _claims(outcomes: Sequence[Outcome]) -> Iterator[Claim]:
    losses = np.array([loss(outcome) for outcome in outcomes])
    stands = np.array([o.psnr["true"] - o.psnr["calibrated"] for o in outcomes])
    for what, lost in (("after registration", losses), ("unshifted", stands)):
        low, high = np.percentile(lost, [10, 90])
        yield Claim(
            f"the calibrated scene's picture {what}, below the true scene's, median",
            f"at most {LARGEST_LOSS} dB",
            f"{np.median(lost):.2f} dB",
            Verdict.of(float(np.median(lost)) <= LARGEST_LOSS),
            f"{len(lost)} draws; a tenth below {low:.1f} dB, a tenth above {high:.1f} dB",
        )
    for sbr in sorted({outcome.sbr for outcome in outcomes}):
        own = [outcome for outcome in outcomes if outcome.sbr == sbr]
        for what, z_of in (("numbers of the scene", _z), ("patches", _patch_z)):
            share, error = _one(own, z_of)
            low, high = WANTED[what]
            trusted = [outcome for outcome in own if outcome.trusted]
            apart = "; none is trusted"
            if trusted:
                apart = f"; of the {len(trusted)} trusted {_one(trusted, z_of)[0]:.0%}"
            yield Claim(
                f"SBR {sbr:g}: {what} within 68 % intervals",
                f"{low:.0%} to {high:.0%}",
                _percent(share, error),
                Verdict.of(low <= share <= high),
                f"{len(own)} draws{apart}",
            )


def _z(outcome: Outcome) -> Array:
    return outcome.z


def _patch_z(outcome: Outcome) -> Array:
    return outcome.patch_z


def _summary(outcomes: Sequence[Outcome]) -> Table:
    rows = []
    for cell in _cells(outcomes):
        of = summary_of(cell)
        shares = [
            _percent(*of[f"{name}_within_1"]) for name in ("numbers", "patches", "matched_patches")
        ]
        rows.append(
            (
                of["scene"],
                f"{of['sbr']:g}",
                str(of["draws"]),
                *(
                    f"{of[f'median_psnr_{name}']:.1f} / {of[f'median_registered_{name}']:.1f}"
                    for name in SCENES
                ),
                f"{of['median_loss']:.1f}",
                *shares,
                f"{of['determined_within_1']} / {of['determined_within_3']} of {of['determined']}",
                str(of["trusted"]),
                f"{of['median_calibration_seconds']:.0f} + "
                f"{of['median_reconstruction_seconds']:.0f}",
            )
        )
    return Table(
        "Medians over draws. PSNR, dB: unshifted / registered, which uses the truth. Shares "
        "within one standard error, ± standard error by how draws differ; of matched patches after "
        "one factor for each channel that fits the truth best.",
        (
            "scene", "SBR", "draws", "ruler", "calibrated", "true scene", "loss, registered",
            "numbers", "patches", "matched", "determined within 1 / 3", "trusted",
            "processor seconds: calibration + picture",
        ),
        rows,
    )  # fmt: skip


def _table(outcomes: Sequence[Outcome]) -> Table:
    rows = []
    for outcome in outcomes:
        of = numbers_of(outcome)
        rows.append(
            (
                of["scene"],
                f"{of['sbr']:g}",
                str(of["draw"]),
                *(f"{outcome.psnr[n]:.1f} / {outcome.registered[n]:.1f}" for n in SCENES),
                f"{of['within_1']} / {of['within_3']} of {of['numbers']}",
                f"{of['determined_within_1']} / {of['determined_within_3']} of {of['determined']}",
                f"{of['worst']} {of['worst_z']:+.1f}",
                f"{of['patches_within_1']:.0%}" + ("" if outcome.geometry else ", no geometry"),
                "yes" if outcome.trusted else of["doubts"],
                f"{of['calibration_seconds']:.0f} + {of['reconstruction_seconds']:.0f}",
            )
        )
    return Table(
        "Each draw. Numbers within 1 / 3 standard errors of the true ones, of all and of those "
        "that the photograph determines; the worst, in standard errors.",
        (
            "scene", "SBR", "draw", "ruler", "calibrated", "true scene", "numbers", "determined",
            "worst", "patches", "trusted", "processor seconds",
        ),
        rows,
    )  # fmt: skip
