"""`periscopy demo`, `doctor`, `tutorial` and `fetch`: commands to begin with."""

import os
import platform
import shutil
import sys
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import options, output, render
from periscopy_sim.cli.options import LightOptions, Out, argument, option
from periscopy_sim.cli.reconstruct import reconstruct
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.errors import EXTRA_OF, OutputError, PeriscopyError, installation
from periscopy_sim.figures import panels
from periscopy_sim.measurement import TARGET
from periscopy_sim.rendering.variant import OVERRIDE, examine_variants, is_vectorized, use_variant
from periscopy_sim.shipped import scenes_folder
from periscopy_sim.storage.published import fetch as fetch_set
from periscopy_sim.storage.published import published_sets
from periscopy_sim.storage.rasters import write_exr


def doctor() -> None:
    """Show versions, missing extras and Mitsuba variants."""
    rows = {"python": f"{platform.python_version()} ({sys.executable})"}
    for package in ("periscopy-sim", "mitsuba", "drjit", "numpy", "scipy", "numba"):
        rows[package] = metadata.version(package)
    for extra in dict.fromkeys(EXTRA_OF.values()):
        modules = [module for module, brought_by in EXTRA_OF.items() if brought_by == extra]
        lacking = ", ".join(module for module in modules if find_spec(module) is None)
        state = f"not installed (lacks {lacking}): {installation(extra)}"
        rows[f"[{extra}]"] = state if lacking else "installed"
    rows["cores"] = str(os.cpu_count())
    for report in examine_variants():
        rows[report.name] = f"{'works' if report.works else 'does not work'}: {report.reason}"
    if os.environ.get(OVERRIDE):
        rows[OVERRIDE] = os.environ[OVERRIDE]
    output.show_table(rows.items())
    output.record(**rows)
    variant = use_variant()
    output.conclude(f"rendering with {variant}", "green" if is_vectorized() else "yellow")


Name = Annotated[str, argument("[NAME]", "A set; all are listed without it.")]
SetFolder = Annotated[Path | None, option("DIR", "Folder to copy the set into.")]


def fetch(name: Name = "", out: SetFolder = None) -> None:
    """Download published photographs.

    Files as their authors lay them out, and an NPZ file of each photograph for `reconstruct`.
    """
    sets = published_sets()
    if not name and out is not None:
        raise PeriscopyError("--out: name the set to fetch")
    if not name:
        output.show_table(
            [each, f"{len(data.files)} files", data.what] for each, data in sets.items()
        )
        output.record(**{each: data.what for each, data in sets.items()})
        return
    with output.progress(f"fetching {name}", "files") as report:
        folder = fetch_set(name, report)
    data_set = sets[name]
    values = "".join(f" -D {key}={value:g}" for key, value in data_set.parameters.items())
    about = {entry: getattr(data_set, entry) for entry in ("cite", "licence", "geometry")}
    about["scene"] = f"--scene {data_set.scene}{values}"
    output.show_table(about.items())
    output.record(**about)
    if out is None:
        output.written(folder)
        return
    with output.output_folder(out) as staged:
        for file in data_set.files:
            (staged / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / file, staged / file)
        for each, arrays in data_set.arrays(folder):
            named: dict[str, Any] = dict(arrays)
            np.savez(staged / f"{each}.npz", **named)


_PIXELS, _EFFORT = "Pixels along each side.", "Fraction of the ambient light's samples."
METHODS = {"preconditioned": "the paper's method", "noise-aware": "noise-aware method"}
"""The methods compared, and how the picture calls them."""


def demo(
    out: options.Out,
    hidden: Annotated[str, option("ROWSxCOLUMNS", "Patches of the hidden image.")] = "29x36",
    resolution: Annotated[int, option("NUMBER", _PIXELS, kind="resolution")] = 126,
    seed: options.Seed = 0,
    effort: Annotated[float, option("NUMBER", _EFFORT, kind="effort")] = 1.0,
) -> None:
    """Photograph a shipped scene, and recover its hidden image."""
    photo, ambient, image = out / "photograph.exr", out / "ambient.exr", "mushroom"
    with output.output_files(ambient) as (file,):
        output.say(f"rendering with {ps.use_variant()}")
        chair = "chair", [hidden], [f"resolution={resolution}"], seed
        scene = PhotoSession(*chair)
        light = scene.ambient_light("ceiling_panels", TARGET / effort**0.5)
        write_exr(file, light.photograph, scene.metadata)
    render.photograph(
        session=scene, image=image, out=photo, ambient=str(ambient), sbr=0.5, snr=60.0
    )  # fmt: skip
    truth, y = scene.scenario.image(image), scene.photograph(photo).values
    pictures = [("hidden image", panels.displayable(truth, white=1))]
    pictures.append(("photograph of the wall", panels.displayable(y)))
    rows = []
    for method, title in METHODS.items():
        doing = output.progress(f"reconstructing by {method}")
        with doing, output.outcome_of(quiet=True, as_json=False) as part:
            reconstruct(
                photo=[photo], session=PhotoSession(*chair), light=LightOptions(), out=out / method,
                method=method, numbers=options.StillNumbers(), truth=[image], uncertain="none",
            )  # fmt: skip
        output.outcome().warnings += part.warnings
        output.written(out / method)
        output.record(**{method: part.numbers})
        psnr, registered = (part.numbers[name] for name in ("psnr", "psnr_registered"))
        rows.append([method, f"{psnr:.2f} dB", f"{registered:.2f} dB"])
        matched = ps.gain_matched(np.load(out / method / "reconstruction.npy"), truth)
        pictures.append((f"{title}\n{psnr:.1f} dB", matched))
    with output.output_files(out / "demo.png") as (file,):
        caption = "chair scene, SBR 0.5; PSNR after one gain per channel"
        panels.draw_panels(file, pictures, caption=caption, metadata=scene.metadata)
    output.show_table(rows, ["method", "PSNR against the truth", "after the best shift"])
    output.conclude(*part.verdicts[-1])  # of the noise-aware method


def tutorial(out: Out) -> None:
    """Copy the tutorial's files; overwrite nothing."""
    shipped = scenes_folder() / "tutorial"
    with output.output_folder(out) as folder:
        for file in sorted(shipped.rglob("*")):
            target = out / file.relative_to(shipped)
            if file.is_file() and target.exists():
                raise OutputError(f"{target} exists already and stays; name another folder")
        # Not their modes: an installed package may be read-only.
        shutil.copytree(shipped, folder, copy_function=shutil.copyfile, dirs_exist_ok=True)
    output.conclude(f"begin with: periscopy lab {out / 'measurements.yaml'} --out lab.xml")
