"""`periscopy demo`, a shipped scene photographed and reconstructed, and `periscopy tutorial`."""

import shutil
from typing import Annotated

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.light import Light
from periscopy_sim.cli.options import Out, option
from periscopy_sim.cli.output import output_folder, say, say_written
from periscopy_sim.cli.reconstruct import reconstruct
from periscopy_sim.cli.render import photograph
from periscopy_sim.cli.session import PhotoSession
from periscopy_sim.errors import OutputError
from periscopy_sim.figures import panels
from periscopy_sim.model.noise import camera_noise
from periscopy_sim.rendering.variant import require_vectorized, use_variant
from periscopy_sim.shipped import scenes_folder
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.outputs.staging import staged_file

METHODS = {"preconditioned": "the paper's method", "noise-aware": "noise-aware method"}
"""The methods compared, and how the picture calls them."""


def demo(
    out: options.Out,
    hidden: Annotated[str, option("ROWSxCOLUMNS", "Patches of the hidden image.")] = "29x36",
    resolution: Annotated[
        int, option("NUMBER", "Pixels along each side.", kind="resolution")
    ] = 126,
    seed: options.Seed = 0,
    effort: Annotated[
        float, option("NUMBER", "Fraction of the path tracer's samples.", kind="effort")
    ] = 1.0,
) -> None:
    """Photograph a shipped scene, and recover its hidden image."""
    photo, ambient, image = out / "photograph.exr", out / "ambient.exr", "mushroom"
    with staged_file(ambient) as file:
        require_vectorized("the demo")
        say(f"rendering with {use_variant()}")
        chair = "chair", [hidden], [f"resolution={resolution}"], seed
        scene = PhotoSession(*chair)
        light = scene.ambient_light("ceiling_panels", 3e-4 / effort**0.5)
        write_exr(file, light, scene.metadata)
    photograph(
        session=scene, image=image, out=photo, samples=max(1, round(effort * 4096)),
        ambient=str(ambient), sbr=0.5, snr=60.0,
    )  # fmt: skip
    truth, y = scene.hidden_image(image), scene.photograph(photo).values
    noise = camera_noise(np.moveaxis(y, -1, 0))  # that of few samples, too
    snr = 60.0 if noise is None else 10 * np.log10(np.mean(y**2) / np.mean(noise**2))
    pictures = [("hidden image", panels.displayable(truth, white=1))]
    pictures.append(("photograph of the wall", panels.displayable(y)))
    for method, title in METHODS.items():
        reconstruct(
            photo=[photo], session=PhotoSession(*chair), light=Light(), out=out / method,
            method=method, numbers=options.StillNumbers(), truth=[image], uncertain="none",
        )  # fmt: skip
        recovered = np.load(out / method / "reconstruction.npy")
        matched = ps.gain_matched(recovered, truth)
        pictures.append((f"{title}: {ps.psnr_gain_matched(recovered, truth):.1f} dB", matched))
    caption = f"chair scene, SBR 0.5, SNR {min(snr, 60):.0f} dB; PSNR after one gain per channel"
    with staged_file(out / "demo.png") as file:
        panels.draw_panels(file, pictures, caption=caption, metadata=scene.metadata)
    say_written(out / "demo.png")


def tutorial(out: Out) -> None:
    """Copy the tutorial's files; overwrite nothing."""
    shipped = scenes_folder() / "tutorial"
    with output_folder(out) as folder:
        for file in sorted(shipped.rglob("*")):
            target = out / file.relative_to(shipped)
            if file.is_file() and target.exists():
                raise OutputError(f"{target} exists already and stays; name another folder")
        # Not their modes: an installed package may be read-only.
        shutil.copytree(shipped, folder, copy_function=shutil.copyfile, dirs_exist_ok=True)
    say(f"begin with: periscopy lab {out / 'measurements.yaml'} --out lab.xml")
