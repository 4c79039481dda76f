"""Pictures to learn from: crops of photographs that well-kept packages ship, and dead leaves.

`python -m experiments.learned.pictures --out DIR` writes them as PNG files. The photographs are
scikit-image's, in the public domain or under CC0 as `skimage.data` says of all but the moon,
Matplotlib's sample of Grace Hopper (public domain), and scikit-learn's `china` and `flower` (CC BY
2.0, danielbuechele and vultilion). `--also FOLDER` takes photographs of yours, too, and panoramas
in EXR files. `WITHHELD` ones are for tests alone. They are few, so that crops are turned over,
recoloured and of any size, and dead leaves stand beside them: discs of a power law of radii that
cover each other, whose edges and spectra are those of photographs (A. Lee, D. Mumford, J. Huang,
"Occlusion models for natural images", IJCV 2001).
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from periscopy_sim.figures.style import mpl
from periscopy_sim.storage.outputs import staged_file
from periscopy_sim.storage.provenance import resumed_folder, sha256_of
from periscopy_sim.storage.rasters import read_exr, srgb_encode

Picture = NDArray[np.float64]

COLOURED = (
    "rocket", "hubble_deep_field", "immunohistochemistry", "retina", "grace_hopper", "china",
    "flower",
)  # fmt: skip
GREY = ("camera", "coins", "brick", "grass", "gravel", "moon", "cell")
WITHHELD = ("astronaut", "coffee", "chelsea")
"""Photographs to learn from, in colour and in grey, and those that the benchmark is of."""

SIZE = 116, 144
"""(rows, columns) of a picture that is written, four points a patch of 29 x 36."""

SMALLEST = 0.15
"""Rows of the smallest crop, over those of the largest."""

LARGEST = 800
"""Photographs of more rows are averaged down by whole numbers to about as many."""

WHITE = 95.0
"""Percentile of a panorama's linear values that is shown as white: skies and lamps are beyond."""

DARK = 0.2
"""Crops without a brighter pixel are drawn anew: parts of the night sky are black."""


def photograph(name: str) -> Picture:
    """Return a shipped photograph, (rows, columns, 3), display values in [0, 1]."""
    if name == "grace_hopper":
        with mpl.cbook.get_sample_data("grace_hopper.jpg") as file:
            values = mpl.image.imread(file, format="jpg")
    elif name in ("china", "flower"):
        from sklearn.datasets import load_sample_image

        values = load_sample_image(f"{name}.jpg")
    else:
        from skimage import data

        values = getattr(data, name)()
    values = np.asarray(values, np.float64) / 255
    return np.repeat(values[..., None], 3, axis=2) if values.ndim == 2 else values[..., :3]


def photographs_of(folder: Path) -> dict[str, Picture]:
    """Return the JPEG, PNG and EXR files of a folder by their names, as `photograph`."""
    from PIL import Image
    from skimage.transform import downscale_local_mean

    found = {}
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() in (".jpg", ".jpeg", ".png"):
            with Image.open(file) as opened:
                values = np.asarray(opened.convert("RGB"), np.float64) / 255
        elif file.suffix.lower() == ".exr":
            linear, _ = read_exr(file)
            values = srgb_encode(np.clip(linear / np.percentile(linear, WHITE), 0, 1))
        else:
            continue
        by = max(1, round(len(values) / LARGEST))
        found[file.name] = downscale_local_mean(values, (by, by, 1))
    return found


def crop(picture: Picture, rng: np.random.Generator) -> Picture:
    """Return a random crop of the form of `SIZE`, of `SMALLEST` to all rows that fit."""
    from skimage.transform import resize

    rows, columns = picture.shape[:2]
    aspect = SIZE[1] / SIZE[0]
    most = min(rows, columns / aspect)
    height = most * SMALLEST ** rng.random()
    tall, wide = int(height), int(height * aspect)
    top, left = rng.integers(rows - tall + 1), rng.integers(columns - wide + 1)
    part = resize(picture[top : top + tall, left : left + wide], SIZE, anti_aliasing=True)
    return np.asarray(part) if part.max() > DARK else crop(picture, rng)


def recoloured(picture: Picture, rng: np.random.Generator, tint: bool) -> Picture:
    """Return a picture turned over at random, of another contrast and colours in another order."""
    if rng.random() < 0.5:
        picture = picture[:, ::-1]
    if rng.random() < 0.25:
        picture = picture[::-1]
    picture = picture[..., rng.permutation(3)] ** rng.uniform(0.7, 1.4)
    if tint:
        dark, bright = rng.random(3) * 0.3, 1 - rng.random(3) ** 2 * 0.8
        picture = dark + (bright - dark) * picture
    return np.asarray(np.clip(picture, 0, 1))


def dead_leaves(rng: np.random.Generator) -> Picture:
    """Return discs that cover each other, of radii r of a density of 1/r³, each of one colour."""
    rows, columns = SIZE
    y, x = np.mgrid[:rows, :columns]
    image = np.zeros((*SIZE, 3))
    bare = np.ones(SIZE, bool)
    least, most = rng.uniform(2, 8), rng.uniform(30, 120)
    base, spread = rng.random(3), rng.uniform(0.1, 0.5)
    while bare.mean() > 0.002:
        # From the front to the back: each disc fills what is bare.
        radius = (least**-2 - rng.random() * (least**-2 - most**-2)) ** -0.5
        row, column = rng.uniform(-radius, rows + radius), rng.uniform(-radius, columns + radius)
        inside = bare & ((y - row) ** 2 + (x - column) ** 2 < radius**2)
        slope = 1 + rng.normal(0, 0.003) * (y - row) + rng.normal(0, 0.003) * (x - column)
        colour = np.clip(base + spread * rng.standard_normal(3), 0, 1)
        image[inside] = (slope[..., None] * colour)[inside]
        bare &= ~inside
    return np.clip(image, 0, 1)


def main(
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")],
    also: Annotated[
        Path | None, typer.Option(help="Folder of photographs in colour to take, too.")
    ] = None,
    crops: Annotated[int, typer.Option(help="Crops of photographs.")] = 9600,
    leaves: Annotated[int, typer.Option(help="Pictures of dead leaves.")] = 800,
    seed: Annotated[int, typer.Option(help="Of the crops and the leaves.")] = 0,
) -> None:
    """Write the pictures to learn from, or those that are missing."""
    from PIL import Image

    others = [] if also is None else sorted(file for file in also.iterdir() if file.is_file())
    settings = {"seed": seed, "crops": crops, "leaves": leaves, "also_sha256": sha256_of(others)}
    with resumed_folder(out, settings, "set of pictures", ["*.png"]):
        pass
    photographs = {name: photograph(name) for name in (*COLOURED, *GREY)}
    if also is not None:
        photographs |= photographs_of(also)
    # A photograph in colour counts as three in grey.
    odds = np.array([1.0 if name in GREY else 3.0 for name in photographs])
    for number in range(crops + leaves):
        file = out / f"{number:05d}.png"
        if file.exists():
            continue
        rng = np.random.default_rng([seed, number])
        if number < crops:
            name = str(rng.choice(list(photographs), p=odds / odds.sum()))
            picture = recoloured(crop(photographs[name], rng), rng, tint=name in GREY)
        else:
            picture = dead_leaves(rng)
        values = np.round(255 * picture).astype(np.uint8)
        with staged_file(file) as staged:
            Image.fromarray(values).save(staged, format="PNG")
    print(f"wrote {crops + leaves} pictures to {out}")


if __name__ == "__main__":
    typer.run(main)
