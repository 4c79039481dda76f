"""Photograph the tutorial's laboratory, and keep the truth apart.

Straight light by stratified shadow rays from every pixel; what bounces, up to six times, by path
tracing. Paint and poster multiply what the wall reflects. They do so for light that bounces off
the wall a second time as if it were even.
"""

from functools import cached_property
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from experiments.laboratories.making import bounces, light, meshes
from experiments.laboratories.making.camera import Camera
from experiments.laboratories.making.paint import Paint, Poster
from experiments.laboratories.making.wall import Seen, pixel_centres, seen_by

Array = NDArray[np.float64]

VARIANT = "llvm_ad_rgb"
SCENE, ROOM = (
    (Path(__file__).parents[1] / "scenes" / f"{name}.xml").read_text("utf-8")
    for name in ("scene", "room")
)
"""The scene file with the true places, the ruler's errors and the camera's film; what else there
is."""

PICTURE = Path(__file__).parents[3] / "scenes" / "images" / "mushroom.png"
HIDDEN = 15, 20
"""Patches of the monitor: rows, columns."""
BLOCK = 4
"""Pixels of the photograph for each pixel of the scene's film, along each side."""
PAINT, POSTER = Paint(seed=5), Poster(0.24, 0.40, 0.04, 0.22, seed=7)
CAMERA = Camera(vignetting=0.15, sensitivity=(0.7, 1.0, 0.7))
SBR = 0.4
"""Mean of the monitor's light over that of all other."""
POINTS = 3, 4
"""Points of the wall that are measured: down and across."""
SEED = 5
BOUNCES = 6
MONITOR_RAYS = 2
"""Shadow rays of each patch, along each of its sides."""
LIGHT_RAYS = 16
PATHS = 16384
COARSE = (20, 30)
DEGREE = 7
SNR = 60.0
"""dB after averaging to the scene's film."""
UNEVENNESS = 0.004
"""Root mean square of the paint, seen at the film's resolution."""


class World:
    """The laboratory as Mitsuba loads it, with its true values.

    Parameters
    ----------
    folder
        Where its mesh is to be.
    film
        (rows, columns) of the scene's film; None for the scene file's own.
    block
        As `BLOCK`.
    """

    def __init__(
        self, folder: Path, film: tuple[int, int] | None = None, block: int = BLOCK
    ) -> None:
        mi.set_variant(VARIANT)
        (folder / "meshes").mkdir(parents=True, exist_ok=True)
        meshes.lamp().export(folder / "meshes" / "lamp.ply")
        file = folder / "room.xml"
        file.write_text(furnished(), "utf-8")
        size = {} if film is None else {"height": film[0], "width": film[1]}
        self.scene = mi.load_file(str(file), **size)
        columns, rows = (int(n) for n in self.scene.sensors()[0].film().size())
        self.size = (rows * block, columns * block)
        self.block = block
        self.shapes: dict[str, Any] = {shape.id(): shape for shape in self.scene.shapes()}
        values = mi.traverse(self.shapes["wall"])["bsdf.reflectance.value"]
        self.reflectance = np.array(values, float).ravel()

    @cached_property
    def hidden(self) -> Array:
        """(R, C, 3) what the monitor shows, of 8 bits as a PNG holds it."""
        pixels = np.asarray(Image.open(PICTURE), float) / 255
        down, across = (
            _coverage(number, length)
            for number, length in zip(HIDDEN, pixels.shape[:2], strict=True)
        )
        shown = np.einsum("ai,bj,ijc->abc", down, across, decoded(pixels))
        return decoded(np.rint(255 * encoded(shown)) / 255)

    @cached_property
    def lights(self) -> list[light.Source]:
        """All other sources than the monitor."""
        return light.sources_in(self.scene.shapes())

    def seen(self, pixels: Array) -> Seen:
        """Return what pixels of the photograph see of the wall."""
        return seen_by(self.scene, pixels, self.size)

    @cached_property
    def centres(self) -> Seen:
        """What the photograph's pixels' centres see."""
        return self.seen(pixel_centres(self.size))

    def light(self) -> dict[str, Array]:
        """Render what the wall sends to the camera if it reflects all, before paint and lens.

        The light of the ``monitor`` and that of the ``room``, (rows, columns, 3), are in the
        ratio `SBR`.
        """
        jitter = np.random.default_rng(SEED).uniform(-0.5, 0.5, (np.prod(self.size), 2))
        seen = self.seen(pixel_centres(self.size) + jitter)
        points = mi.Point3f(seen.points.T.astype(np.float32))
        normal = mi.Vector3f(*seen.normal.tolist())
        monitor = light.source_of(self.shapes["monitor"], self.hidden)

        def straight(source: light.Source, strata: tuple[int, int], number: int) -> Array:
            return light.direct_irradiance(self.scene, points, normal, source, strata, number)

        down, across = (MONITOR_RAYS * number for number in HIDDEN)
        direct = [straight(monitor, (down, across), 11 + SEED)]
        direct.append(
            sum(
                straight(source, (LIGHT_RAYS, LIGHT_RAYS), 101 + index)
                for index, source in enumerate(self.lights)
            )
        )
        rows, columns = self.size
        coarse = self.seen(pixel_centres(COARSE) * [columns / COARSE[1], rows / COARSE[0]])
        bounced = bounces.bounced_radiance(
            self.scene,
            coarse.points,
            coarse.normal,
            [[monitor], self.lights],
            bounces=BOUNCES,
            samples=PATHS,
            seed=SEED,
        )
        totals = []
        for first, rest in zip(direct, bounced, strict=True):
            smooth = bounces.interpolated(coarse.positions, rest, seen.positions, DEGREE)
            totals.append((first / np.pi + smooth).reshape(*self.size, 3))
        signal, background = ((self.reflectance * each).mean() for each in totals)
        return {"monitor": totals[0], "room": totals[1] * (signal / background / SBR)}

    def wall(self) -> Array:
        """Return the wall's reflectance, (rows, columns, 3)."""
        places = self.centres.places
        paint = PAINT.at(places).reshape(*self.size, 1)
        poster = POSTER.covers(places)
        on_film = averaged(paint, self.block)
        clear = averaged(poster.reshape(*self.size, 1).astype(float), self.block) == 0
        paint = UNEVENNESS * (paint - on_film[clear].mean()) / on_film[clear].std()
        reflectance = (self.reflectance * (1 + paint)).reshape(-1, 3)
        reflectance[poster] = POSTER.reflectance(places[poster])
        return reflectance.reshape(*self.size, 3)


def furnished() -> str:
    """Return the text of the scene with all that stands around, as Mitsuba alone reads it."""
    around = ROOM.partition('<scene version="3.0.0">')[2].rpartition("</scene>")[0]
    head, end, rest = SCENE.rpartition("</scene>")
    return head + around + end + rest


def make(folder: Path) -> None:
    """Render the laboratory: what a user has into a folder, the truth into its folder ``truth``."""
    truth = folder / "truth"
    world = World(truth)
    (truth / "scene.xml").write_text(SCENE, "utf-8")
    _write_photographs(world, folder)
    shown = np.rint(255 * encoded(world.hidden)).astype(np.uint8)
    Image.fromarray(np.kron(shown, np.ones((16, 16, 1), np.uint8))).save(truth / "hidden.png")
    _write_points(world, folder / "points.csv")
    _write_poster(world, folder / "poster.png")


def _write_photographs(world: World, folder: Path) -> None:
    """Write a photograph and one with the monitor off."""
    light_of = {name: each.astype(np.float32) for name, each in world.light().items()}
    both = light_of["monitor"] + light_of["room"]
    lens = CAMERA.lens(world.centres.positions).reshape(*world.size, 1)
    even = world.reflectance * lens * both
    signal = CAMERA.counts_per_radiance(even) * even * CAMERA.sensitivity
    power = (averaged(signal, BLOCK) ** 2).mean() * 10 ** (-SNR / 10)
    # Variance for each count of signal.
    shot = float((power * BLOCK**2 - CAMERA.read_noise**2) / signal.mean())
    wall = world.wall() * lens
    gain = CAMERA.counts_per_radiance(wall * both)
    pictures = {"photograph": both, "monitor_off": light_of["room"]}
    for index, (name, falling) in enumerate(pictures.items()):
        tifffile.imwrite(
            folder / f"{name}.tiff",
            CAMERA.expose(wall * falling, gain, shot, 1000 * SEED + 10 * index),
            photometric="rgb",
            compression="zlib",
            predictor=True,
        )


def _write_points(world: World, file: Path) -> None:
    """Write points of the wall: clicked to 0.3 pixels, measured to a millimetre."""
    rng = np.random.default_rng([SEED, 30])
    rows, columns = world.size
    down, across = (np.linspace(0.06, 0.94, number) for number in POINTS)
    grid = np.stack(np.meshgrid(across, down), -1).reshape(-1, 2)
    pixels = (grid + rng.uniform(-0.04, 0.04, grid.shape)) * [columns, rows]
    seen = world.seen(pixels)
    errors = 1e-3 * rng.standard_normal((len(pixels), 2))
    measured = seen.points + errors @ np.array([seen.across, seen.up])
    clicked = pixels + 0.3 * rng.standard_normal(pixels.shape)
    lines = [
        f"{column:.1f},{row:.1f},{x:.4f},{y:.4f},{z:.4f}"
        for (column, row), (x, y, z) in zip(clicked, measured, strict=True)
    ]
    file.write_text("\n".join(["column,row,x,y,z", *lines]) + "\n", "utf-8")


def _write_poster(world: World, file: Path) -> None:
    """Write what a person paints over in the photograph: the poster, with a margin."""
    used = ~POSTER.covers(world.centres.places, margin=0.012).reshape(world.size)
    Image.fromarray(np.where(used, 255, 0).astype(np.uint8)).save(file)


def averaged(picture: Array, block: int) -> Array:
    """Average whole blocks of pixels."""
    rows, columns = picture.shape[0] // block, picture.shape[1] // block
    return picture.reshape(rows, block, columns, block, -1).mean(axis=(1, 3))


def encoded(linear: Array) -> Array:
    """Return linear light by the sRGB curve."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def decoded(values: Array) -> Array:
    """Return the linear light of sRGB values in [0, 1]."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _coverage(boxes: int, pixels: int) -> Array:
    """Return (boxes, pixels) weights that average equal pixels over equal boxes."""
    edges = np.linspace(0, pixels, boxes + 1)
    upper = np.minimum(edges[1:, None], np.arange(1, pixels + 1))
    lower = np.maximum(edges[:-1, None], np.arange(pixels))
    return np.asarray(np.maximum(upper - lower, 0) * boxes / pixels)
