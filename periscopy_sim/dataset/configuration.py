"""The description of a data set: a YAML file, checked before anything is rendered.

Its numbers are fixed, or drawn anew each time. Each source is an entry of the configuration. From a
random generator alone it draws an image, (R, C, 3) of linear light in [0, 1], or the frames of a
clip, (frames, R, C, 3), each with some light.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from periscopy_sim.dataset.reading import CHANNELS, Size
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.validation import RANGES
from periscopy_sim.photograph import ColourMatrix
from periscopy_sim.shipped import find_condition, find_scene
from periscopy_sim.storage import formats, pictures, provenance
from periscopy_sim.storage.yaml_document import Number, Sizes, Strict, ranged, read_yaml

Pair = tuple[Number, Number]


class Distribution(Strict):
    """A number, or how to draw one: exactly one of these is given."""

    value: Number | None = None  # in the file the bare number
    uniform: Pair | None = None  # [low, high]
    log_uniform: Pair | None = None  # [low, high]: draws all orders of magnitude alike
    normal: Pair | None = None  # [mean, standard deviation]
    choice: Annotated[tuple[Number, ...], Field(min_length=1)] | None = None  # all alike

    @model_validator(mode="before")
    @classmethod
    def _from_number(cls, given: Any) -> Any:
        return given if isinstance(given, cls | dict) else {"value": given}

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if sum(given is not None for _, given in self) != 1:
            raise ValueError(
                "give a number, or one of uniform: [low, high], log_uniform: [low, high], "
                "normal: [mean, standard deviation], choice: [numbers]"
            )
        low, high = self.uniform or self.log_uniform or (0, 0)
        deviation = self.normal[1] if self.normal else 0
        if low > high or deviation < 0 or (self.log_uniform and low <= 0):
            raise ValueError("an interval runs backwards or, if log_uniform, down to 0; or a "
                             "standard deviation is negative")  # fmt: skip
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Return the least and the greatest that can be drawn."""
        if self.normal is not None:
            return (-math.inf, math.inf) if self.normal[1] else (self.normal[0],) * 2
        values = self.choice or self.uniform or self.log_uniform or (self.value or 0.0,)
        return min(values), max(values)

    @property
    def is_continuous(self) -> bool:
        """Return whether no two draws are alike."""
        return self.bounds[0] < self.bounds[1] and self.choice is None

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a number."""
        if self.uniform is not None:
            return float(rng.uniform(*self.uniform))
        if self.log_uniform is not None:
            low, high = np.log(self.log_uniform)
            # Rounding could leave the interval by an ulp.
            return float(np.clip(np.exp(rng.uniform(low, high)), *self.log_uniform))
        if self.normal is not None:
            return float(rng.normal(*self.normal))
        if self.choice is not None:
            return self.choice[int(rng.integers(len(self.choice)))]
        assert self.value is not None
        return self.value


class Source(Strict):
    """An entry of a list that is drawn from by weight, relative to the others."""

    weight: Annotated[Number, Field(gt=0, le=1e6)] = 1.0

    def located(self, folder: Path) -> Self:  # noqa: ARG002
        """Return the source with absolute paths, from a configuration's folder; they must exist."""
        return self

    def identity(self) -> dict[str, Any]:
        """Return entries that replace paths in an archive: names, and digests of contents."""
        return {}


def within(*ends: Any) -> Any:
    """Return a type for distributions that are drawn from [low, high], or from a kind's range."""
    low, high = ends if len(ends) == 2 else RANGES[ends[0]].ends

    def check(distribution: Distribution) -> Distribution:
        least, most = distribution.bounds
        if not (low <= least and most <= high):
            raise ValueError(f"every value must lie from {low:g} to {high:g}")
        return distribution

    return Annotated[Distribution, AfterValidator(check)]


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
        return self.model_copy(
            update={"folder": place, "version": provenance.sha256_of(pictures_in(place))}
        )

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
    known = formats.suffixes(raw=False)
    candidates = (file for file in Path(folder).rglob("*") if file.suffix.lower() in known)
    files = tuple(sorted(file for file in candidates if not file.name.startswith(".")))
    if not files:
        raise ConfigurationError(f"folder '{folder}' holds no pictures ({', '.join(known)})")
    return files


@lru_cache(maxsize=512)
def _picture(file: str, shape: tuple[int, int], version: str) -> Array:  # noqa: ARG001
    image = pictures.read_hidden_image(file, shape)
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


EXAMPLE = Path(__file__).with_name("example.yaml")

SPLITS = ("train", "validation", "test")

Triple = tuple[Number, Number, Number]

Files = Annotated[tuple[str, ...], Field(min_length=1)]
"""Paths, relative to the configuration's folder."""


class SceneSource(Source):
    """A scene, and what varies in it from geometry to geometry."""

    scene: str
    version: str = ""  # digest of the scene's files, filled in when a data set is made
    parameters: dict[str, Distribution | str] = Field(default_factory=dict)

    def located(self, folder: Path) -> Self:
        """Return the source with the absolute path of its scene and the digest of its files."""
        beside = folder / self.scene
        path = (beside if beside.is_file() else find_scene(self.scene)).resolve()
        return self.model_copy(
            update={"scene": str(path), "version": provenance.scene_sha256(path)}
        )

    def identity(self) -> dict[str, Any]:
        """Return the name of the scene."""
        return {"scene": Path(self.scene).stem}


class Lamps(Source):
    """Point lights at random places, by Eq. 4.

    They lie `across`, `away` from the wall and `up`, in metres from the centre of the camera's
    field of view; `tint` is the standard deviation of the logarithm of each lamp's colour.
    """

    kind: Literal["lamps"]
    number: within(1, 1000) = Distribution(choice=(1, 2, 3, 4, 5, 6))  # type: ignore[valid-type]
    across: within(-1000, 1000) = Distribution(uniform=(-3.0, 3.0))  # type: ignore[valid-type]
    away: within(0.05, 1000) = Distribution(uniform=(1.0, 7.0))  # type: ignore[valid-type]
    up: within(-1000, 1000) = Distribution(uniform=(-3.0, 3.0))  # type: ignore[valid-type]
    tint: within(0, 3) = Distribution(value=0.2)  # type: ignore[valid-type]

    def draw(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw places, (L, 3) as (across, away, up), and powers, (L, 3) by channel."""
        count = round(self.number.draw(rng))
        axes = (self.across, self.away, self.up)
        places = np.array([[axis.draw(rng) for axis in axes] for _ in range(count)])
        brightness = rng.uniform(0.2, 1.0, (count, 1))
        return places, brightness * np.exp(self.tint.draw(rng) * rng.standard_normal((count, 3)))


class Mixture(Source):
    """Pictures of ambient light of the photographs' size, of which some are drawn and added."""

    mixed: within(1, 100) = Distribution(value=1.0)  # type: ignore[valid-type]
    flip: bool = True  # about the photograph's axes, at random


class Conditions(Mixture):
    """Lighting conditions, rendered as `periscopy ambient` does, on the first geometry's wall."""

    kind: Literal["conditions"]
    names: Files  # or shipped conditions
    target: Annotated[float, ranged("error")] = 3e-4  # relative error when rendered

    def located(self, folder: Path) -> Self:
        """Return the source with absolute paths of the conditions that are not shipped."""
        beside = [(folder / name).resolve() for name in self.names]
        names = [str(p) if p.is_file() else n for p, n in zip(beside, self.names, strict=True)]
        return self.model_copy(update={"names": tuple(names)})

    def identity(self) -> dict[str, Any]:
        """Return names and digests of the conditions."""
        digests = [provenance.scene_sha256(find_condition(name)) for name in self.names]
        return {"names": [Path(name).stem for name in self.names], "sha256": digests}


class Pictures(Mixture):
    """Photographs of ambient light, such as real ones."""

    kind: Literal["pictures"]
    files: Files

    def located(self, folder: Path) -> Self:
        """Return the source with absolute paths."""
        files = tuple(str((folder / name).resolve()) for name in self.files)
        return self.model_copy(update={"files": files})

    def identity(self) -> dict[str, Any]:
        """Return the names of the files and the digest of all of them."""
        names = [Path(name).name for name in self.files]
        return {"files": names, "sha256": provenance.sha256_of(map(Path, self.files))}


class Darkness(Source):
    """No ambient light."""

    kind: Literal["none"]


AmbientSource = Annotated[Lamps | Conditions | Pictures | Darkness, Field(discriminator="kind")]


Share = Annotated[Number, Field(ge=0, le=1)]


class Splits(Strict):
    """Shares of the geometries, of sum 1."""

    train: Share = 0.8
    validation: Share = 0.1
    test: Share = 0.1

    @model_validator(mode="after")
    def _sum_to_one(self) -> Self:
        if abs(self.train + self.validation + self.test - 1) > 1e-6:
            raise ValueError("the shares of train, validation and test must sum to 1")
        return self


Rays = Annotated[int, ranged("rays")]


class Direct(Strict):
    """Photographs A f: light that the wall reflects once; A errs less than their noise."""

    kind: Literal["direct"] = "direct"
    samples: Rays | None = None  # from each pixel's centre to each patch; None: see `planned`


class Bounced(Strict):
    """Photographs A f with light that bounces between all surfaces, hardly noisy of their own."""

    kind: Literal["bounced"]
    samples: Rays | None = None
    bounces: Annotated[int, ranged("bounces"), Field(ge=2)] | None = None  # reflections at most


SOURCES = "hidden_images", "ambient", "scenes"
"""Entries that are lists of sources."""


class Configuration(Strict):
    """A data set's description; ``example.yaml`` beside this file explains each entry.

    `folder`, where relative paths start, is set by `load_configuration`.
    """

    seed: Annotated[int, ranged("seed")] = 0
    count: Size
    hidden: Sizes
    samples_per_geometry: Size = 1000
    samples_per_shard: Annotated[int, ranged("count")] = 50
    clip_length: Size = 1
    splits: Splits = Splits()
    scenes: Annotated[tuple[SceneSource, ...], Field(min_length=1)]
    hidden_images: Annotated[tuple[HiddenSource, ...], Field(min_length=1)]
    ambient: Annotated[tuple[AmbientSource, ...], Field(min_length=1)]
    light: Annotated[Direct | Bounced, Field(discriminator="kind")] = Direct()
    sbr: within("ratio") = Distribution(log_uniform=(0.05, 10.0))  # type: ignore[valid-type]
    snr: within("decibels") = Distribution(value=60.0)  # type: ignore[valid-type]
    exposure: within("exposure") = Distribution(value=1.0)  # type: ignore[valid-type]
    colour_matrix: Annotated[tuple[Triple, ...], Field(min_length=3)] | None = None
    saturation: Annotated[Number, Field(gt=0)] | None = None
    photograph_type: Literal["float32", "float16"] = "float32"
    keep_background: bool = False
    folder: Path = Path()

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        self.colours  # noqa: B018  raises where the matrix mixes colours up
        for whole, part in (
            ("samples_per_shard", "clip_length"),
            ("samples_per_geometry", "samples_per_shard"),
        ):
            size, of = getattr(self, whole), getattr(self, part)
            if size % of:
                raise ValueError(f"{whole} ({size}) must be a multiple of {part} ({of})")
        return self

    @property
    def colours(self) -> ColourMatrix | None:
        """From the monitor's primaries to the camera's channels; None for the identity."""
        return None if self.colour_matrix is None else ColourMatrix(np.array(self.colour_matrix))

    @property
    def channels(self) -> int:
        """Return the number of the camera's channels."""
        return len(self.colour_matrix or CHANNELS)

    @property
    def geometries(self) -> int:
        """Return the number of geometries; the last may be cut short."""
        return -(-self.count // self.samples_per_geometry)

    def located(self) -> "Configuration":
        """Return the configuration with absolute paths; an error names one that does not exist."""
        lists = {
            name: tuple(source.located(self.folder) for source in getattr(self, name))
            for name in SOURCES
        }
        return self.model_copy(update=lists)

    def identity(self) -> dict[str, Any]:
        """Return all entries that a sample depends on, of JSON's types, without paths."""
        entries = self.model_dump(mode="json", exclude={"count", "folder"})
        if self.colour_matrix is None:
            del entries["colour_matrix"]  # older data sets have none
        for name in SOURCES:
            for entry, source in zip(entries[name], getattr(self, name), strict=True):
                entry |= source.identity()
        return entries


def load_configuration(path: str | Path) -> Configuration:
    """Read a data set's configuration, a YAML file.

    A file that is no YAML is a `ConfigurationError`; so is an entry that is unknown, missing or out
    of range, with its line.
    """
    return read_yaml(Path(path), Configuration)
