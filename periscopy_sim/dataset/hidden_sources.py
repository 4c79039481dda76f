"""Images and short videos on the hidden monitor: generators, and folders of pictures.

Each source is an entry of the configuration. From a random generator alone it draws an image, (R,
C, 3) of linear light in [0, 1], or the frames of a clip, (frames, R, C, 3), each with some light.
"""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from periscopy_sim.dataset.distributions import Distribution, Source, within
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.numerics import Array
from periscopy_sim.storage.formats.table import suffixes
from periscopy_sim.storage.formats.yaml_document import Number
from periscopy_sim.storage.outputs.provenance import sha256_of
from periscopy_sim.storage.pictures import read_hidden_image

Rng = np.random.Generator

OVERSAMPLING = 8
"""Points a patch across and down that drawings are averaged over (test_hidden_sources)."""


class Shapes(Source):
    """Ellipses, rectangles, triangles and stars before a plain background.

    `size` is their radius over the image's height, `speed` the heights that each moves from frame
    to frame, in a direction of its own; walls reflect it.
    """

    kind: Literal["shapes", "moving"]
    number: within(1, 100) = Distribution(choice=(1, 2, 3, 4, 5))  # type: ignore[valid-type]
    size: within(1e-3, 10) = Distribution(uniform=(0.08, 0.35))  # type: ignore[valid-type]
    speed: within(0, 10) | None = None  # type: ignore[valid-type]

    def draw(self, rng: Rng, shape: tuple[int, int], frames: int) -> Array:
        """Draw a clip, or an image of shapes at rest."""
        size = np.array([shape[1] / shape[0], 1.0])
        moving, rest = Distribution(uniform=(0.01, 0.06)), Distribution(value=0.0)
        speed = self.speed or (moving if self.kind == "moving" else rest)
        count = round(self.number.draw(rng))
        ground = _colour(rng) * rng.uniform(0, 0.5)
        corners = [_outline(rng) * self.size.draw(rng) for _ in range(count)]
        colours = [_colour(rng) for _ in range(count)]
        start = rng.random((count, 2)) * size
        heading = rng.uniform(0, 2 * np.pi, count)
        pace = np.array([speed.draw(rng) for _ in range(count)])
        velocity = pace[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        clip = np.empty((frames, *shape, len(ground)))
        for t in range(frames):
            # Straight paths, folded into the image as if its edges were mirrors.
            places = np.abs((start + t * velocity + size) % (2 * size) - size)
            clip[t] = ground
            for outline, place, colour in zip(corners, places, colours, strict=True):
                covered = _polygon(outline + place, shape)
                clip[t] += covered * (colour - clip[t])
        return clip


class Text(Source):
    """Letters, digits and signs, bright before dark or dark before bright.

    `length` of them stand side by side. The `height` is that of a capital letter, over the image's;
    it is made smaller where the text would not fit.
    """

    kind: Literal["text", "digits"]
    characters: Annotated[str, Field(pattern=r"^\S+$", max_length=1000)] | None = None
    length: within(1, 40) | None = None  # type: ignore[valid-type]
    height: within(0.05, 2) = Distribution(uniform=(0.35, 0.9))  # type: ignore[valid-type]

    def draw(self, rng: Rng, shape: tuple[int, int], frames: int) -> Array:  # noqa: ARG002
        """Draw an image."""
        digits = self.kind == "digits"
        characters = self.characters or ("0123456789" if digits else _LETTERS)
        length = self.length or Distribution(choice=(1,) if digits else (1, 2, 3, 4))
        text = "".join(rng.choice(list(characters), round(length.draw(rng))))
        covered = _lettering(text, self.height.draw(rng), rng.random(2), shape)
        ground, ink = _contrasting(rng)
        return ground + covered * (ink - ground)


class Gratings(Source):
    """Sinusoids or stripes of any direction, in two colours; `periods` over the image's height."""

    kind: Literal["gratings"]
    periods: within(0.01, 1000) = Distribution(log_uniform=(0.5, 8.0))  # type: ignore[valid-type]
    square: Annotated[Number, Field(ge=0, le=1)] = 0.5  # share of stripes

    def draw(self, rng: Rng, shape: tuple[int, int], frames: int) -> Array:  # noqa: ARG002
        """Draw an image."""
        rows, columns = (OVERSAMPLING * size for size in shape)
        y, x = (np.arange(rows)[:, None] + 0.5) / rows, (np.arange(columns) + 0.5) / rows
        direction, phase = rng.uniform(0, 2 * np.pi, 2)
        turns = 2 * np.pi * self.periods.draw(rng)
        down, along = turns * np.sin(direction) * y + phase, turns * np.cos(direction) * x
        # The sine of the sum, of so many fewer angles.
        wave = np.sin(down) * np.cos(along) + np.cos(down) * np.sin(along)
        if rng.random() < self.square:
            wave = np.where(wave > 0, 1.0, -1.0)
        ground, ink = _contrasting(rng)
        return ground + _patch_means((1 + wave) / 2, shape) * (ink - ground)


class Smooth(Source):
    """Random fields without edges: Gaussian, of a power-law spectrum.

    Amplitudes fall with the power `exponent` of the frequency. A `saturation` of 0 is grey, one of
    1 has three independent channels.
    """

    kind: Literal["smooth"]
    exponent: within(0, 10) = Distribution(uniform=(1.5, 3.0))  # type: ignore[valid-type]
    saturation: within(0, 1) = Distribution(uniform=(0.0, 1.0))  # type: ignore[valid-type]

    def draw(self, rng: Rng, shape: tuple[int, int], frames: int) -> Array:  # noqa: ARG002
        """Draw an image."""
        # Twice as large as needed, so that opposite edges differ.
        tall, wide = 2 * shape[0], 2 * shape[1]
        frequency = np.hypot(np.fft.fftfreq(tall)[:, None], np.fft.rfftfreq(wide))
        frequency[0, 0] = np.inf  # no mean
        spectrum = np.fft.rfft2(rng.standard_normal((4, tall, wide)))
        fields = np.fft.irfft2(spectrum * frequency ** -self.exponent.draw(rng), (tall, wide))
        fields = fields[:, : shape[0], : shape[1]]
        fields -= fields.mean(axis=(1, 2), keepdims=True)
        fields /= np.maximum(fields.std(axis=(1, 2), keepdims=True), 1e-300)
        s = self.saturation.draw(rng)
        image = np.moveaxis((1 - s) * fields[:1] + s * fields[1:], 0, -1)
        low, high = image.min(), image.max()
        return np.asarray((image - low) / (high - low) if high > low else image + 0.5)


class Folder(Source):
    """Pictures of a folder and of those within it."""

    kind: Literal["folder"]
    folder: str  # relative to the configuration's own
    flip: bool = False  # half of them, left to right
    version: str = ""  # digest of the pictures, filled in when a data set is made

    def located(self, folder: Path) -> Self:
        """Return the source with an absolute path and the digest of its pictures."""
        place = str((folder / self.folder).resolve())
        pictures_in.cache_clear()
        return self.model_copy(update={"folder": place, "version": sha256_of(pictures_in(place))})

    def identity(self) -> dict[str, Any]:
        """Return the name of the folder; `version` is the digest of its pictures."""
        return {"folder": Path(self.folder).name}

    def draw(self, rng: Rng, shape: tuple[int, int], frames: int) -> Array:  # noqa: ARG002
        """Draw an image; the folder is an absolute path by now."""
        files = pictures_in(self.folder, self.version)
        image = _picture(str(files[int(rng.integers(len(files)))]), shape, self.version)
        return image[:, ::-1] if self.flip and rng.random() < 0.5 else image


HiddenSource = Annotated[Shapes | Text | Gratings | Smooth | Folder, Field(discriminator="kind")]


@lru_cache(maxsize=64)
def pictures_in(folder: str, version: str = "") -> tuple[Path, ...]:  # noqa: ARG001
    """Return the pictures of a folder, sorted; remembered for each version of it."""
    known = suffixes(raw=False)
    candidates = (file for file in Path(folder).rglob("*") if file.suffix.lower() in known)
    files = tuple(sorted(file for file in candidates if not file.name.startswith(".")))
    if not files:
        raise ConfigurationError(f"folder '{folder}' holds no pictures ({', '.join(known)})")
    return files


@lru_cache(maxsize=512)
def _picture(file: str, shape: tuple[int, int], version: str) -> Array:  # noqa: ARG001
    image = read_hidden_image(file, shape)
    if not image.any():
        raise ConfigurationError(f"{file}: is black; leave it out")
    if image.shape[2] != 3:
        raise ConfigurationError(
            f"{file}: has {image.shape[2]} channels; give three, or one of grey"
        )
    image.flags.writeable = False
    return image


_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789&?!#%+=@"


def _colour(rng: Rng) -> Array:
    """Draw a colour whose brightest channel is 1 or, half of the time, less."""
    colour = rng.random(3) ** 2 + 1e-3
    return np.asarray(colour / colour.max() * rng.uniform(0.5, 1.0))


def _contrasting(rng: Rng) -> tuple[Array, Array]:
    """Draw a dark and a bright colour, either way round."""
    dark, bright = _colour(rng) * rng.uniform(0, 0.2), _colour(rng)
    return (dark, bright) if rng.random() < 0.7 else (bright, dark)


_CORNERS = {"ellipse": 48, "rectangle": 4, "triangle": 3, "star": 10}


def _outline(rng: Rng) -> Array:
    """Return (n, 2) corners (x, y) of a shape of radius about 1, turned by a random angle."""
    kind, corners = list(_CORNERS.items())[rng.integers(len(_CORNERS))]
    turn = rng.uniform(0, 2 * np.pi)
    angle = 2 * np.pi * np.arange(corners) / corners + np.pi / corners
    radius = np.where(np.arange(corners) % 2, 0.45, 1.0) if kind == "star" else np.ones(corners)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    if kind in ("ellipse", "rectangle"):
        points[:, 1] *= rng.uniform(0.3, 1.0)
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray(points @ np.array([[c, s], [-s, c]]))


def _patch_means(image: NDArray[Any], shape: tuple[int, int]) -> Array:
    """Return the mean of an oversampled image over each patch: (R, C, 1)."""
    k = OVERSAMPLING
    rows = image.reshape(shape[0], k, -1).sum(axis=1)  # both axes at once take 20 times as long
    return np.asarray(rows.reshape(*shape, k, 1).sum(axis=2) / k**2)


def _coverage(shape: tuple[int, int], draw: Callable[[Any], None]) -> Array:
    """Return the fraction of each patch that a drawing covers: (R, C, 1)."""
    from PIL import Image, ImageDraw

    mask = Image.new("L", (OVERSAMPLING * shape[1], OVERSAMPLING * shape[0]))
    draw(ImageDraw.Draw(mask))
    return _patch_means(np.asarray(mask), shape) / 255


def _polygon(corners: Array, shape: tuple[int, int]) -> Array:
    """Return the fraction of each patch within a polygon given in image heights: (R, C, 1)."""
    places = (OVERSAMPLING * shape[0] * corners).ravel().tolist()
    return _coverage(shape, lambda canvas: canvas.polygon(places, fill=255))


def _lettering(text: str, height: float, place: Array, shape: tuple[int, int]) -> Array:
    """Return the fraction of each patch within letters: (R, C, 1)."""
    room = OVERSAMPLING * np.array(shape[::-1])
    font = _font(max(8, round(height * room[1] / 0.72)))  # a capital is 0.72 of the font's size
    box = np.reshape(font.getbbox(text), (2, 2))
    if (shrink := np.min(0.96 * room / (box[1] - box[0]))) < 1:
        font = _font(max(8, int(font.size * shrink)))
        box = np.reshape(font.getbbox(text), (2, 2))
    corner = place * (room - (box[1] - box[0])) - box[0]
    return _coverage(shape, lambda canvas: canvas.text(tuple(corner), text, fill=255, font=font))


@lru_cache(maxsize=256)
def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)
