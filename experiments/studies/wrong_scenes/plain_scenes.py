"""Plain scenes: Mitsuba's own objects, photographed by plain Mitsuba, direct light only.

Nobody tuned the calibration on these six scenes. Their photographs are independent of the package's
transport matrices: `mi.load_file` reads the scene file, and `mi.render` renders it, once with the
picture as a bitmap on the monitor, and once with a black monitor and three far lamps.
"""

from pathlib import Path

import numpy as np

from experiments.setting import kept
from experiments.studies.wrong_scenes.subjects import SEED, Photographed, Subject
from experiments.worlds.making import bitmap, renderings
from periscopy_sim.numerics import Array
from periscopy_sim.storage.provenance import array_sha256, scene_sha256

SCENES = Path(__file__).with_name("scenes")

SAMPLES = 288**2
"""Stratified samples of the monitor, for each pixel and rendering."""

PASSES = 2
"""Renderings that are averaged. Their grain is 0.04 to 0.07 % of the mean light. That of edges,
whose light falls on a small fraction of the wall, is 0.16 %."""

SHOWN = {
    "boxes": ((18, 24), "digits"),
    "plant": ((18, 24), "checker"),
    "tripod": ((18, 24), "bars"),
    "mesh": ((18, 24), "mushroom"),
    "edges": ((18, 24), "siemens"),
    "mug": ((18, 22), "letters"),
}
"""(R, C) of each scene's hidden image, and the shipped picture that its monitor shows."""


def plain_subjects() -> dict[str, Subject]:
    """Return the plain scenes by name."""
    files = {name: SCENES / f"{name}.xml" for name in SHOWN}
    return {
        name: Subject(name, file, file, *SHOWN[name], "lamps", samples=SAMPLES)
        for name, file in files.items()
    }


def photographed_plainly(subject: Subject, folder: Path) -> Photographed:
    """Render a subject by plain Mitsuba, or read the renderings that a folder holds."""
    truth = subject.at().image(subject.image)
    files = [folder / subject.name / f"{name}.exr" for name in (subject.image, subject.place)]
    signal = _rendered(subject, files[0], truth, "0")
    ambient = _rendered(subject, files[1], np.zeros_like(truth), "1")
    return Photographed(subject, truth, signal, ambient)


def _rendered(subject: Subject, file: Path, shown: Array, lamps: str) -> Array:
    depends = {
        "scene_sha256": scene_sha256(subject.lit),
        "parameters": str(dict(subject.parameters)),
        "truth_sha256": array_sha256(np.round(shown, 6)),
        "samples": str(subject.samples),
        "passes": str(PASSES),
        "seed": str(SEED),
    }

    def render() -> Array:
        passes = plain_renderings(subject, file, shown, lamps)
        grain = np.sqrt(passes.var(axis=0, ddof=1).mean() / PASSES) / passes.mean()
        print(f"{subject.name}, {file.stem}: a grain of {100 * grain:.3f} %", flush=True)
        return np.asarray(passes.mean(axis=0))

    return kept(file, depends, render)


def plain_renderings(subject: Subject, file: Path, shown: Array, lamps: str) -> Array:
    """Return `PASSES` renderings of a subject whose monitor shows a picture, (.., h, w, 3)."""
    picture = bitmap(file.with_stem(f"{file.stem}_shown"), shown)
    samples = subject.samples if lamps == "0" else subject.samples // 16
    given = {**subject.parameters, "shown": picture, "lamps": lamps}
    return renderings(subject.lit, SEED, passes=PASSES, samples=samples, **given)
