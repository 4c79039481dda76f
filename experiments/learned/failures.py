"""Where learning fails: learned methods beside the noise-aware one, on photographs of other kinds.

`python -m experiments.learned.failures --out DIR [--real FILE.npz] [--samples DIR]` reconstructs
photographs of each of `conditions.CONDITIONS`, and a real one if given (arrays `photograph` and
`hidden`), by each method. It prints the gain over the noise-aware method in dB, after each
channel's best gain and the best shift of at most two patches, and draws it beside one image of
each condition. Standard errors take the photographs as independent. `adapted` is the unrolled
network after `adaptation` to the scene that it is told, in the conditions of `ADAPTED`.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, styled
from experiments.learned.conditions import CONDITIONS, Array, Condition, Trial, trial
from experiments.learned.resuming import digest_of, hold_settings
from experiments.learned.samples import HIDDEN, Samples
from experiments.setting import Setting
from periscopy_sim.figures.panels import displayable
from periscopy_sim.reconstruction.registry import METHODS
from periscopy_sim.storage.outputs.staging import staged_file

NOISE_AWARE, ADAPTED = "noise-aware", "adapted"
NAMES = ("preconditioned", "unet", "plug-and-play", "unrolled")
COLORS = {
    "preconditioned": "0.6",
    "unet": "#CC79A7",
    "plug-and-play": "#E69F00",
    "unrolled": "#0072B2",
    ADAPTED: "#56B4E9",
}
GEOMETRIES = 3
ADAPTED_IN = ("a plate for the chair", "a plant for the chair", "the ruler's errors")

Row = dict[str, Any]


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    samples: Annotated[
        Path | None, typer.Option(help="What experiments.learned.samples wrote, to adapt by.")
    ] = None,
    real: Annotated[Path | None, typer.Option(help="A real photograph of the chair scene.")] = None,
) -> None:
    """Reconstruct, or go on where a run was stopped; print and draw."""
    given = {"samples": samples, "real": real}
    files = {name: [] if path is None else sorted(path.glob("*.npz")) if path.is_dir() else [path]
             for name, path in given.items()}  # fmt: skip
    settings = {f"{name}_sha256": digest_of(each) for name, each in files.items()}
    hold_settings(out, "*.csv", "table of failures", settings)
    setting = Setting(out, real)
    setting.rendered.mkdir(exist_ok=True)
    images = [] if samples is None else training_images(samples)
    table = out / "failures.csv"
    rows = read_rows(table)
    done = {row["condition"] for row in rows}
    for condition in CONDITIONS:
        if condition.name not in done:
            rows += tried(condition, setting, images, out)
            write_rows(table, rows)
            print(line_of(condition.name, rows), flush=True)
    if real is not None and "real photograph" not in done:
        rows += compared("real photograph", of_real(setting), out, images)
        write_rows(table, rows)
        print(line_of("real photograph", rows), flush=True)
    draw_gains(rows, out / "gains.png")
    draw_images(read_images(out, rows), out / "images.png")
    print(f"wrote {table}, {out / 'gains.png'}")


def tried(condition: Condition, setting: Setting, images: list[Array], out: Path) -> list[Row]:
    """Return the rows of a condition, a photograph and method each."""
    geometries = GEOMETRIES if condition.scene == "chair" else 1
    rows: list[Row] = []
    for number in range(geometries):
        made = trial(condition, number, setting)
        adapting = images if condition.name in ADAPTED_IN and number == 0 else []
        rows += compared(condition.name, made, out, adapting, condition.scene, number)
    return rows


def of_real(setting: Setting) -> Trial:
    """Return the real photograph, in the scene as the ruler says it is."""
    measured = setting.measured
    return Trial(setting.scenario, {"mushroom": measured.signal}, {"mushroom": measured.truth})


def compared(
    name: str,
    made: Trial,
    out: Path,
    images: list[Array],
    scene: str = "chair",
    number: int = 0,
) -> list[Row]:
    """Return the rows of a geometry; `images` to adapt by, none for no adaptation.

    Images of the first photograph are written, to be drawn.
    """
    A, B = ps.render_transport(made.scenario), ps.point_light_backgrounds(made.scenario)
    methods: dict[str, Any] = {each: METHODS[each](made.scenario, A, B)
                               for each in (NOISE_AWARE, *NAMES)}  # fmt: skip
    if images:
        from experiments.learned.adaptation import adapt  # it needs PyTorch

        weights = out / f"{name}.safetensors"
        adapt(made.scenario, scene, images, weights, seed=number)
        methods[ADAPTED] = ps.Learned.for_scene(made.scenario, A, B, weights=weights)
    rows = []
    for image, photograph in made.photographs.items():
        truth = made.truths[image]
        found = {each: method.reconstruct(photograph) for each, method in methods.items()}
        for each, result in found.items():
            psnr = ps.registered(result, truth).psnr
            rows.append({"condition": name, "geometry": number, "image": image, "method": each,
                         "psnr": ps.psnr(result, truth), "registered": psnr})  # fmt: skip
        if number == 0 and image == next(iter(made.photographs)):
            drawn_images = {each: ps.gain_matched(result, truth) for each, result in found.items()}
            np.savez(out / f"{name}.npz", truth=truth, **drawn_images)
    return rows


def training_images(samples: Path) -> list[Array]:
    """Return hidden images of the training, (R, C, 3), of unit maximum, as `adapt` takes them."""
    file = sorted(samples.glob("*_right.npz"))[0]
    return [np.moveaxis(truth / truth.max(), 0, -1) for truth in Samples.read(file).truth]


def gains(rows: list[Row], condition: str, method: str) -> Array:
    """Return a method's gains over the noise-aware one in dB, a photograph each."""
    psnr = {
        (row["geometry"], row["image"], row["method"]): row["registered"]
        for row in rows
        if row["condition"] == condition
    }
    return np.array(
        [
            value - psnr[geometry, image, NOISE_AWARE]
            for (geometry, image, name), value in psnr.items()
            if name == method
        ]
    )


def line_of(condition: str, rows: list[Row]) -> str:
    """Return a condition's row of the table: mean gains and their standard errors."""
    own = [row["registered"] for row in rows
           if row["condition"] == condition and row["method"] == NOISE_AWARE]  # fmt: skip
    cells = [f"{condition} | {len(own)} | {np.mean(own):.1f}"]
    for name in (*NAMES, ADAPTED):
        gained = gains(rows, condition, name)
        error = gained.std(ddof=1) / np.sqrt(len(gained)) if len(gained) > 1 else np.nan
        told = f" ({error:.2f})" if np.isfinite(error) else ""
        cells.append(f"{gained.mean():+.2f}{told}" if len(gained) else "")
    return "| " + " | ".join(cells) + " |"


def read_rows(table: Path) -> list[Row]:
    """Return the rows of an earlier run."""
    if not table.is_file():
        return []
    with table.open(encoding="utf-8", newline="") as opened:
        numbers = {"geometry": int, "psnr": float, "registered": float}
        return [
            {name: numbers.get(name, str)(value) for name, value in row.items()}
            for row in csv.DictReader(opened)
        ]


def read_images(out: Path, rows: list[Row]) -> dict[str, dict[str, Array]]:
    """Return images of a photograph of each condition, by method."""
    shown = {}
    for condition in dict.fromkeys(row["condition"] for row in rows):
        with np.load(out / f"{condition}.npz") as held:
            shown[condition] = dict(held)
    return shown


def write_rows(table: Path, rows: list[Row]) -> None:
    """Write all rows."""
    with staged_file(table) as staged, staged.open("w", encoding="utf-8", newline="") as opened:
        writer = csv.DictWriter(opened, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def draw_gains(rows: list[Row], file: Path) -> None:
    """Draw mean gains of each condition, with two standard errors, and each photograph's."""
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    names = [name for name in (*NAMES, ADAPTED) if any(row["method"] == name for row in rows)]
    with styled(), drawn(file.parent, file.stem, PAGE, 0.55 * PAGE) as figure:
        ax = figure.subplots()
        for offset, name in zip(np.linspace(-0.3, 0.3, len(names)), names, strict=True):
            for place, condition in enumerate(conditions):
                gained = gains(rows, condition, name)
                if not len(gained):
                    continue
                y = np.full(len(gained), place + offset)
                ax.plot(gained, y, ".", color=COLORS[name], alpha=0.3, markersize=3)
                error = 2 * gained.std(ddof=1) / np.sqrt(len(gained)) if len(gained) > 1 else 0
                ax.errorbar(gained.mean(), place + offset, xerr=error, fmt="o", markersize=3.5,
                            color=COLORS[name], label=name if place == 0 else None)  # fmt: skip
            if name == ADAPTED:
                ax.plot([], [], "o", color=COLORS[name], label=f"unrolled, {ADAPTED}")
        ax.axvline(0, color="k", linewidth=0.8)
        ax.set_yticks(range(len(conditions)), conditions)
        ax.invert_yaxis()
        ax.set(xlabel="gain over the noise-aware method (dB, registered)", xlim=(-12, 4))
        ax.legend(loc="center left", bbox_to_anchor=(1, 0.5))


def draw_images(shown: dict[str, dict[str, Array]], file: Path) -> None:
    """Draw one photograph's images of each condition side by side."""
    names = ["truth", NOISE_AWARE, *NAMES, ADAPTED]
    height = PAGE * len(shown) / len(names) * HIDDEN[0] / HIDDEN[1]
    with styled(), drawn(file.parent, file.stem, PAGE, height) as figure:
        axes = figure.subplots(len(shown), len(names), squeeze=False)
        for row, (condition, images) in zip(axes, shown.items(), strict=True):
            for ax, name in zip(row, names, strict=True):
                ax.set(xticks=[], yticks=[])
                ax.spines[:].set_visible(False)
                if name in images:
                    ax.imshow(displayable(images[name]), interpolation="nearest")
                if ax is row[0]:
                    ax.set_ylabel(condition, fontsize=5)
        for ax, name in zip(axes[0], names, strict=True):
            ax.set_title(name, fontsize=6)


if __name__ == "__main__":
    typer.run(main)
