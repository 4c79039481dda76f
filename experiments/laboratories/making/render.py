"""Photograph a stand-in laboratory, and keep the truth apart.

Straight light by stratified shadow rays from every pixel; what bounces, up to six times, by path
tracing. Paint and posters multiply what the wall reflects. They do so for light that bounces off
the wall a second time as if it were even.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from experiments.laboratories.making import bounces, light, ruler
from experiments.laboratories.making.camera import averaged, write_jpeg, write_tiff
from experiments.laboratories.making.laboratory import Laboratory
from experiments.laboratories.making.wall import Seen, film_size, pixel_centres, seen_by

Array = NDArray[np.float64]

VARIANT = "llvm_ad_rgb"
IMAGES = Path(__file__).parents[3] / "scenes" / "images"
BOUNCES = 6
MONITOR_RAYS = 2
"""Shadow rays of each patch, along each of its sides."""
LIGHT_RAYS = 16
PATHS = 16384
COARSE = (20, 30)
DEGREE = 7


@dataclass(frozen=True, eq=False)
class Light:
    """What the wall sends to the camera if it reflects all of it, (rows, columns, 3) each.

    Attributes
    ----------
    monitor
        Straight and bounced light of the monitor.
    room
        Of all other sources, at the laboratory's signal-to-background ratio.
    bounced
        Share of bounced light in the two.
    left
        What the polynomial left of the bounced light over its standard error, root mean square.
    """

    monitor: Array
    room: Array
    bounced: tuple[float, float]
    left: tuple[float, float]


class World:
    """A laboratory as Mitsuba loads it, with its true values.

    Parameters
    ----------
    laboratory
        The laboratory.
    folder
        Where its meshes are.
    film
        (rows, columns) of the scene's film; None for the scene file's own.
    """

    def __init__(
        self, laboratory: Laboratory, folder: Path, film: tuple[int, int] | None = None
    ) -> None:
        mi.set_variant(VARIANT)
        self.laboratory = laboratory
        file = folder / "room.xml"
        file.write_text(laboratory.room, "utf-8")
        size = {} if film is None else {"height": film[0], "width": film[1]}
        self.scene = mi.load_file(str(file), **size)
        rows, columns = film_size(self.scene)
        self.film = (rows, columns)
        self.size = (rows * laboratory.block, columns * laboratory.block)

    @cached_property
    def shapes(self) -> dict[str, Any]:
        """Of the scene, by id."""
        return {shape.id(): shape for shape in self.scene.shapes()}

    @cached_property
    def hidden(self) -> Array:
        """(R, C, 3) what the monitor shows, of 8 bits as a PNG holds it."""
        pixels = np.asarray(Image.open(IMAGES / f"{self.laboratory.hidden_image}.png"), float) / 255
        down, across = (
            _coverage(number, length)
            for number, length in zip(self.laboratory.hidden, pixels.shape[:2], strict=True)
        )
        shown = np.einsum("ai,bj,ijc->abc", down, across, decoded(pixels))
        return decoded(np.rint(255 * encoded(shown)) / 255)

    @cached_property
    def monitor(self) -> light.Source:
        """The monitor with its picture."""
        return light.source_of(self.shapes["monitor"], self.hidden, self.laboratory.exponents)

    @cached_property
    def lights(self) -> list[light.Source]:
        """All other sources."""
        return light.sources_in(self.scene.shapes())

    @cached_property
    def reflectance(self) -> Array:
        """(3,) of the wall's colour."""
        values = mi.traverse(self.shapes["wall"])["bsdf.reflectance.value"]
        return np.array(values, float).ravel()

    def seen(self, pixels: Array) -> Seen:
        """Return what pixels of the photograph see of the wall."""
        return seen_by(self.scene, self.laboratory.camera, pixels, self.size)

    def light(self, jitter: bool = True) -> Light:
        """Render what falls on the wall, before paint and lens."""
        laboratory = self.laboratory
        centres = pixel_centres(self.size)
        if jitter:
            centres = centres + np.random.default_rng(laboratory.seed).uniform(
                -0.5, 0.5, centres.shape
            )
        seen = self.seen(centres)
        points = mi.Point3f(seen.points.T.astype(np.float32))
        normal = mi.Vector3f(*seen.normal.tolist())
        down, across = (MONITOR_RAYS * number for number in laboratory.hidden)
        straight = [
            light.direct_irradiance(
                self.scene, points, normal, self.monitor, (down, across), 11 + laboratory.seed
            )
        ]
        straight.append(
            sum(
                light.direct_irradiance(
                    self.scene, points, normal, source, (LIGHT_RAYS, LIGHT_RAYS), 101 + index
                )
                for index, source in enumerate(self.lights)
            )
        )
        rows, columns = self.size
        grid = pixel_centres(COARSE) * [columns / COARSE[1], rows / COARSE[0]]
        coarse = self.seen(grid)
        bounced, error = bounces.bounced_radiance(
            self.scene,
            coarse.points,
            coarse.normal,
            [[self.monitor], self.lights],
            bounces=BOUNCES,
            samples=PATHS,
            seed=laboratory.seed,
        )
        totals, shares, left = [], [], []
        for direct, indirect, deviation in zip(straight, bounced, error, strict=True):
            fit, rest = bounces.smooth_over_film(coarse.positions, indirect, DEGREE)
            over = bounces.over_film(fit, seen.positions, DEGREE)
            totals.append((direct / np.pi + over).reshape(*self.size, 3))
            shares.append(float(over.mean() / totals[-1].mean()))
            left.append(float(np.sqrt((rest**2).mean() / (deviation**2).mean())))
        monitor, room = totals
        signal, background = ((self.reflectance * each).mean() for each in totals)
        room = room * (signal / background / laboratory.sbr)
        return Light(monitor, room, (shares[0], shares[1]), (left[0], left[1]))

    @cached_property
    def centres(self) -> Seen:
        """What the photograph's pixels' centres see."""
        return self.seen(pixel_centres(self.size))

    def wall(self, unevenness: float) -> Array:
        """Return the wall's reflectance, (rows, columns, 3), with paint of a root mean square."""
        laboratory, places = self.laboratory, self.centres.places
        paint = laboratory.paint.at(places).reshape(*self.size, 1)
        poster = np.zeros(len(places), bool)
        if laboratory.poster:
            poster = laboratory.poster.covers(places)
        on_film = averaged(paint, laboratory.block)
        clear = averaged(poster.reshape(*self.size, 1).astype(float), laboratory.block) == 0
        paint = unevenness * (paint - on_film[clear].mean()) / on_film[clear].std()
        reflectance = (self.reflectance * (1 + paint)).reshape(-1, 3)
        if laboratory.poster:
            reflectance[poster] = laboratory.poster.reflectance(places[poster])
        return reflectance.reshape(*self.size, 3)


def make(laboratory: Laboratory, out: Path) -> Path:
    """Render a laboratory into a folder of its name, unless the same is there.

    What a user has lies in the folder, the truth in its folder ``truth``.

    Returns
    -------
    Path
        The folder.
    """
    folder = out / laboratory.name
    made_from = _digest(laboratory, sorted(Path(__file__).parent.glob("*.py")))
    record = folder / "truth" / "values.json"
    if record.is_file() and json.loads(record.read_text("utf-8"))["made_from"] == made_from:
        return folder
    truth = folder / "truth"
    for meshes in (folder / "meshes", truth / "meshes"):
        meshes.mkdir(parents=True, exist_ok=True)
        for name, build in laboratory.meshes.items():
            build().export(meshes / f"{name}.ply")
    (truth / "scene.xml").write_text(laboratory.scene, "utf-8")
    world = World(laboratory, truth)
    radiance = _kept_light(world, truth / "light.npz")
    shot = _shot_noise(world, radiance)
    for kind, unevenness in laboratory.unevenness.items():
        _photograph(world, radiance, kind, unevenness, shot, folder)
    _write_truth(world, radiance, truth)
    rulers = [_measure(world, number, folder) for number in range(laboratory.rulers)]
    _write_points(world, folder)
    _write_poster(world, folder / "poster.png")
    values = {
        "made_from": made_from,
        "true": ruler.declared(laboratory.scene),
        "rulers": rulers,
        "sbr": laboratory.sbr,
        "snr": laboratory.snr,
        "unevenness": dict(laboratory.unevenness),
        "bounced_share_of_monitor_and_room": radiance.bounced,
        "left_by_interpolation_over_its_error": radiance.left,
    }
    record.write_text(json.dumps(values, indent=2) + "\n", "utf-8")
    return folder


def _photograph(
    world: World, radiance: Light, kind: str, unevenness: float, shot: float, folder: Path
) -> None:
    """Write a photograph and two with the monitor off; of the usual wall also a dark frame."""
    camera, seed = world.laboratory.camera, world.laboratory.seed
    lens = camera.lens(world.centres.positions).reshape(*world.size, 1)
    wall = world.wall(unevenness) * lens
    lit = wall * (radiance.monitor + radiance.room)
    gain = camera.counts_per_radiance(lit)
    ending = f"_{kind}" if kind else ""
    pictures = {"photograph": lit} | dict.fromkeys(
        ("monitor_off", "monitor_off_2"), wall * radiance.room
    )
    if not kind:
        pictures["dark"] = np.zeros_like(lit)
    for index, (name, picture) in enumerate(pictures.items()):
        number = 1000 * seed + 10 * index + sorted(world.laboratory.unevenness).index(kind)
        counts = camera.expose(picture, gain, shot, number)
        write_tiff(folder / f"{name}{ending}.tiff", counts)
        if name == "photograph":
            write_jpeg(folder / f"{name}{ending}.jpg", camera.developed(counts), camera.quality)


def _shot_noise(world: World, radiance: Light) -> float:
    """Return the variance, for each count of signal, that gives the SNR on the scene's film."""
    camera, block = world.laboratory.camera, world.laboratory.block
    lens = camera.lens(world.centres.positions).reshape(*world.size, 1)
    lit = world.reflectance * lens * (radiance.monitor + radiance.room)
    signal = camera.counts_per_radiance(lit) * lit * camera.sensitivity
    power = (averaged(signal, block) ** 2).mean() * 10 ** (-world.laboratory.snr / 10)
    return float((power * block**2 - camera.read_noise**2) / signal.mean())


def _write_truth(world: World, radiance: Light, truth: Path) -> None:
    shown = np.rint(255 * encoded(world.hidden)).astype(np.uint8)
    block = np.ones((16, 16, 1), np.uint8)
    Image.fromarray(np.kron(shown, block)).save(truth / "hidden.png")
    np.save(truth / "hidden.npy", world.hidden)
    for name, light_ in (("monitor", radiance.monitor), ("room", radiance.room)):
        on_film = averaged(world.reflectance * light_, world.laboratory.block)
        np.save(truth / f"{name}.npy", on_film.astype(np.float32))
    paint = averaged(world.wall(1.0) / world.reflectance - 1, world.laboratory.block)[..., 0]
    np.save(truth / "paint_of_unit_rms.npy", paint.astype(np.float32))


def _measure(world: World, number: int, folder: Path) -> dict[str, float]:
    """Write the scene files that one person's ruler gives; return what it read.

    In ``ruler.xml`` the camera's numbers carry no error: its picture is brought to that camera by
    points of the wall. In ``ruler_camera.xml`` they do.
    """
    laboratory = world.laboratory
    read = ruler.read_by_ruler(laboratory.scene, 100 * laboratory.seed + number)
    text = ruler.with_values(laboratory.scene, read)
    ending = f"_{number}" if number else ""
    (folder / f"ruler_camera{ending}.xml").write_text(text, "utf-8")
    rectified = ruler.without_errors(text, laboratory.measured_camera)
    (folder / f"ruler{ending}.xml").write_text(rectified, "utf-8")
    return read


def _write_points(world: World, folder: Path) -> None:
    """Write points of the wall: clicked to 0.3 pixels, measured to a millimetre."""
    rng = np.random.default_rng([world.laboratory.seed, 30])
    rows, columns = world.size
    down, across = (np.linspace(0.06, 0.94, number) for number in world.laboratory.points)
    grid = np.stack(np.meshgrid(across, down), -1).reshape(-1, 2)
    pixels = (grid + rng.uniform(-0.04, 0.04, grid.shape)) * [columns, rows]
    seen = world.seen(pixels)
    wall = light.source_of(world.shapes["wall"], np.ones((1, 1, 3)))
    axes = [axis / np.linalg.norm(axis) for axis in (wall.across, wall.up)]
    measured = seen.points + 1e-3 * rng.standard_normal((len(pixels), 2)) @ np.array(axes)
    clicked = pixels + 0.3 * rng.standard_normal(pixels.shape)
    lines = [
        f"{column:.1f},{row:.1f},{x:.4f},{y:.4f},{z:.4f}"
        for (column, row), (x, y, z) in zip(clicked, measured, strict=True)
    ]
    (folder / "points.csv").write_text("\n".join(["column,row,x,y,z", *lines]) + "\n", "utf-8")


def _write_poster(world: World, file: Path) -> None:
    """Write what a person paints over in the photograph: the poster, with a margin."""
    poster, used = world.laboratory.poster, np.ones(world.size, bool)
    if poster:
        used = ~poster.covers(world.centres.places, margin=0.012).reshape(world.size)
    Image.fromarray(np.where(used, 255, 0).astype(np.uint8)).save(file)


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
    weights: Array = np.maximum(upper - lower, 0) * boxes / pixels
    return weights


def _kept_light(world: World, file: Path) -> Light:
    """Render the light, or read it if the same was rendered before."""
    here = Path(__file__).parent
    code = [here / f"{name}.py" for name in ("light", "bounces", "wall")]
    made_from = f"{_digest(world.laboratory, code)} {world.laboratory.camera.distortion}"
    if file.is_file():
        with np.load(file) as kept:
            if str(kept["made_from"]) == made_from:
                shares = (tuple(kept[name].tolist()) for name in ("bounced", "left"))
                return Light(kept["monitor"], kept["room"], *shares)
    made = world.light()
    single = {name: getattr(made, name).astype(np.float32) for name in ("monitor", "room")}
    np.savez(file, made_from=made_from, bounced=made.bounced, left=made.left, **single)
    return Light(single["monitor"], single["room"], made.bounced, made.left)


def _digest(laboratory: Laboratory, code: Sequence[Path]) -> str:
    """Return the SHA-256 of code and of what a laboratory is made from, its meshes included."""
    digest = hashlib.sha256()
    for build in laboratory.meshes.values():
        digest.update(build().export(file_type="ply"))
    for file in (*code, IMAGES / f"{laboratory.hidden_image}.png"):
        digest.update(file.read_bytes())
    settings = (laboratory.room, laboratory.seed, laboratory.sbr, laboratory.hidden)
    digest.update(repr(settings).encode())
    return digest.hexdigest()
