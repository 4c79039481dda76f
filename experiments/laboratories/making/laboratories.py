"""The stand-in laboratories."""

from __future__ import annotations

from experiments.laboratories.making import meshes
from experiments.laboratories.making.camera import Camera
from experiments.laboratories.making.laboratory import Laboratory
from experiments.laboratories.making.paint import Paint, Poster

LAMP = Laboratory(
    name="lamp",
    hidden_image="still_life",
    hidden=(18, 32),
    block=8,
    meshes={"lamp": meshes.lamp},
    paint=Paint(seed=1),
    poster=Poster(0.22, 0.5, 0.06, 0.3, seed=3),
    camera=Camera(),
    seed=1,
)

PLATE = Laboratory(
    name="plate",
    hidden_image="mushroom",
    hidden=(20, 26),
    block=5,
    meshes={"plate": meshes.plate},
    paint=Paint(grain=(0.004, 0.004), passes=(0.2, 0.0), seam=(0.0, 1.0, 0.0), dirt=1.0, seed=2),
    camera=Camera(vignetting=0.1, sensitivity=(0.8, 1.0, 0.55), quality=85),
    sbr=0.2,
    seed=2,
)
SHELF = Laboratory(
    name="shelf",
    hidden_image="digits",
    hidden=(21, 28),
    block=5,
    meshes={"shelf": meshes.shelf},
    paint=Paint(grain=(0.003, 0.02), passes=(0.1, 0.7), seam=(-0.07, 0.004, 0.4), seed=3),
    camera=Camera(vignetting=0.2, black=128, white=4095, read_noise=1.5),
    poster=Poster(0.02, 0.12, -0.20, -0.10, seed=5),
    sbr=0.5,
    seed=3,
)
BOTTLE = Laboratory(
    name="bottle",
    hidden_image="sunset",
    hidden=(30, 20),
    block=5,
    meshes={"bottle": meshes.bottle},
    paint=Paint(passes=(0.25, 0.3), seam=(-0.05, 0.012, 0.3), dirt=0.5, seed=4),
    camera=Camera(vignetting=0.45, distortion=-0.04, sensitivity=(0.5, 1.0, 0.8)),
    points=(5, 4),
    sbr=0.6,
    seed=4,
)

TUTORIAL = Laboratory(
    name="tutorial",
    hidden_image="mushroom",
    hidden=(15, 20),
    block=4,
    meshes={"lamp": meshes.lamp},
    paint=Paint(seed=5),
    camera=Camera(vignetting=0.15, sensitivity=(0.7, 1.0, 0.7)),
    poster=Poster(0.24, 0.40, 0.04, 0.22, seed=7),
    sbr=0.4,
    rulers=1,
    seed=5,
)
"""Small enough to be shipped, see `tutorial`."""

LABORATORIES = {laboratory.name: laboratory for laboratory in (LAMP, PLATE, SHELF, BOTTLE)}
