"""`periscopy demo`, a shipped scene photographed and reconstructed, and `periscopy tutorial`."""

import shutil
from typing import Annotated

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import options, output
from periscopy_sim.cli.light import LightOptions
from periscopy_sim.cli.options import Out, option
from periscopy_sim.cli.reconstruct import reconstruct
from periscopy_sim.cli.render import photograph
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.errors import OutputError
from periscopy_sim.figures import panels
from periscopy_sim.shipped import scenes_folder
from periscopy_sim.storage.formats.exr import write_exr

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
        light = scene.ambient_light("ceiling_panels", 3e-4 / effort**0.5)
        write_exr(file, light.photograph, scene.metadata)
    photograph(
        session=scene, image=image, out=photo, ambient=str(ambient), sbr=0.5, snr=60.0
    )  # fmt: skip
    truth, y = scene.scenario.image(image), scene.photograph(photo).values
    pictures = [("hidden image", panels.displayable(truth, white=1))]
    pictures.append(("photograph of the wall", panels.displayable(y)))
    rows = []
    for method, title in METHODS.items():
        with output.part_of_command() as part:
            reconstruct(
                photo=[photo], session=PhotoSession(*chair), light=LightOptions(), out=out / method,
                method=method, numbers=options.StillNumbers(), truth=[image], uncertain="none",
            )  # fmt: skip
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
