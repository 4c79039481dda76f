"""What is photographed, what the search for a silhouette is given of it, and what is true.

The rendered occluders are flat masks of 16 x 16 cells of 5 mm where the shipped plate stands. Their
scene and the searched one are two files: the search is given the photograph and a scene with a
square of 8 cm in the place of the mask.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.setting import SNR, kept
from periscopy_sim.calibration.silhouette.plane import mask_plane
from periscopy_sim.calibration.silhouette.scene import with_mesh
from periscopy_sim.cli.ambient import ambient_photographs
from periscopy_sim.errors import PhotographError
from periscopy_sim.evaluation.sweep import array_sha256
from periscopy_sim.rendering.scene.mesh_formats import TriangleMesh, write_ply
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.formats.srgb import srgb_decode
from periscopy_sim.storage.outputs.provenance import as_text, provenance
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

F = (
    "................",
    "................",
    "....########....",
    "....########....",
    "....##..........",
    "....##..........",
    "....##..........",
    "....######......",
    "....######......",
    "....##..........",
    "....##..........",
    "....##..........",
    "....##..........",
    "....##..........",
    "................",
    "................",
)
PLATE = (
    "................",
    "................",
    *["...##########..."] * 8,
    *[".......##......."] * 6,
)
CHAIR = (
    "................",
    "................",
    *["...##..........."] * 5,
    *["...##########..."] * 2,
    *["...##......##..."] * 5,
    "................",
    "................",
)
BLOB = (
    "................",
    "................",
    "......####......",
    "....########....",
    "...##########...",
    "...###########..",
    "..############..",
    "..#########.....",
    "...#######......",
    "...########.....",
    "....##########..",
    "....##########..",
    ".....########...",
    ".......####.....",
    "................",
    "................",
)

SIDE = 0.08
"""Of the square about a mask, in metres."""

RAYS = 16, 9
"""To places of a patch, from places of a pixel, for the monitor's light that falls straight on the
wall. 16384 paths a pixel take longer, and leave a grain of 0.12 to 0.17 %, above the noise."""

PATHS = 484
"""Of a pixel, for the light that bounces on the way."""

SEED = 15
"""Of the rendered light."""

FINE = 16
"""Points along each side of a cell at which an outline is looked at."""


SOLID = "chair that is not flat"
"""Name of the case of the shipped chair."""

PUBLISHED = (29, 36)
"""Patches of the published photographs' hidden images."""


@dataclass(frozen=True)
class Mask:
    """A mask that is rendered.

    Attributes
    ----------
    name
        Of the case.
    cells
        Rows of the mask, "#" where it is opaque, as one sees it who faces the wall.
    image
        Name of the shipped picture that the monitor shows.
    sbr
        Signal-to-background ratio.
    hidden
        (R, C) of the hidden image.
    shift
        Cells by which the mask is moved to the right and down.
    place
        Name of the shipped place whose ambient light falls on the wall.
    """

    name: str
    cells: Sequence[str]
    image: str
    sbr: float
    hidden: tuple[int, int] = (18, 22)
    shift: tuple[float, float] = (0.0, 0.0)
    place: str = "overcast"

    @property
    def folder(self) -> str:
        """Name of a folder for all cases of this mask before this image."""
        made_from = (*self.cells, self.image, self.hidden, self.shift)
        return f"mask_{zlib.crc32(repr(made_from).encode()):08x}"


MASKS = (
    Mask("letter F", F, "mushroom", 0.5),
    Mask("plate on a stick", PLATE, "letters", 0.5),
    Mask("chair", CHAIR, "mushroom", 10.0),
    Mask("blob", BLOB, "bars", 10.0),
    Mask("letter F between cells", F, "mushroom", 0.5, (29, 36), (0.4, 0.3)),
    Mask("letter F beside a window", F, "mushroom", 0.5, place="window_left"),
)


@dataclass(frozen=True, eq=False)
class Sought:
    """All that the search for a silhouette is given.

    Attributes
    ----------
    photograph
        (rows, columns, 3), linear.
    used
        (rows, columns) the pixels to look at; None for all.
    scene, parameters
        A scene file, and values of its ``<default>``s.
    shape
        Id of the shape that stands for the unknown one.
    hidden, cells
        (R, C) of the hidden image; (rows, columns) of the mask, None for the usual.
    """

    photograph: Array
    used: Cells | None
    scene: Path
    shape: str
    hidden: tuple[int, int]
    cells: tuple[int, int] | None = None
    parameters: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Truth:
    """What is found is compared with this.

    Attributes
    ----------
    image
        (R, C, 3) what the monitor showed, linear.
    placed
        Whether it is known where on the monitor; else images are not measured against it.
    scene
        A scene file with the true occluder.
    outline
        (rows n, columns n) where the true occluder is within the rectangle, seen from the middle of
        the monitor to that of the wall.
    """

    image: Array
    placed: bool
    scene: Path
    outline: Cells


@dataclass(frozen=True, eq=False)
class Subject:
    """A case: what is sought, and what is true. `sbr` is None of a real photograph."""

    name: str
    image: str
    sbr: float | None
    sought: Sought
    truth: Truth


def rendered(mask: Mask, folder: Path) -> Subject:
    """Photograph a mask, all bounces, or take what a folder holds of it."""
    own = folder / mask.folder
    searched, true = write_scenes(mask, own)
    scene = ps.load_scenario(true, mask.hidden)
    image = ps.read_hidden_image(ps.find_image(mask.image), mask.hidden)
    signal = _lit(scene, image, own / "light.exr", mask.name)
    # The wall and the camera are those of the shipped plate, one light for all masks.
    wall = ps.load_scenario(ps.find_scene("plate"), mask.hidden)
    photograph = _photograph(mask.name, signal, mask.place, mask.sbr, wall, folder)
    return Subject(
        mask.name,
        mask.image,
        mask.sbr,
        Sought(photograph, None, searched, "plate", mask.hidden, np.shape(cells_of(mask))),
        Truth(image, True, true, drawn(mask)),
    )


def _photograph(
    name: str, signal: Array, place: str, sbr: float, wall: Scenario, folder: Path
) -> Array:
    """Return the monitor's light beside that of a place on a scene's wall, with a case's noise."""
    ambient = ambient_photographs([place], wall, folder, SEED)[place]
    return ps.add_noise(ps.composite(signal, ambient, sbr), SNR, zlib.crc32(name.encode()))


def cells_of(mask: Mask) -> Cells:
    """Return (rows, columns) of a mask that is not moved."""
    return np.array([[cell == "#" for cell in row] for row in mask.cells])


def drawn(mask: Mask) -> Cells:
    """Return the outline of a mask where it stands, see `Truth`."""
    fine = cells_of(mask).repeat(FINE, axis=0).repeat(FINE, axis=1)
    right, down = (round(FINE * step) for step in mask.shift)
    moved = np.zeros_like(fine)
    moved[down:, right:] = fine[: len(fine) - down, : fine.shape[1] - right]
    return moved


def write_scenes(mask: Mask, folder: Path) -> tuple[Path, Path]:
    """Write the scene that is searched, with a square, and the true one, with the mask."""
    bare, searched, true = (folder / f"{name}.xml" for name in ("bare", "searched", "true"))
    side = {"plate_width": str(SIDE), "plate_height": str(SIDE)}
    _write(bare, with_mesh(ps.find_scene("plate"), "stick", None, side, folder))
    square = mesh_of(np.ones((1, 1), bool))
    for scene, mesh in ((searched, square), (true, mesh_of(cells_of(mask), mask.shift))):
        with staged_file(scene.with_suffix(".ply")) as file:
            write_ply(file, mesh)
        _write(scene, with_mesh(bare, "plate", f"{scene.stem}.ply", {}, folder))
    return searched, true


def mesh_of(opaque: Cells, shift: tuple[float, float] = (0.0, 0.0)) -> TriangleMesh:
    """Return opaque cells as squares in the plate's own coordinates, from -1 to 1."""
    rows, columns = opaque.shape
    top, left = np.argwhere(opaque).T + np.array(shift)[::-1, None]
    corners = np.array([(0, 0), (0, 1), (1, 1), (1, 0)])
    x = 2 * (left[:, None] + corners[:, 0]) / columns - 1
    z = 1 - 2 * (top[:, None] + corners[:, 1]) / rows
    vertices = np.stack([x, 0 * x, z], axis=-1).reshape(-1, 3)
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    faces = (4 * np.arange(len(x))[:, None, None] + triangles).reshape(-1, 3)
    return TriangleMesh(vertices, faces)


def solid_chair(folder: Path) -> Subject:
    """Photograph the shipped chair, all bounces; it is known as a box about it alone."""
    scene = ps.load_scenario(ps.find_scene("chair"), PUBLISHED)
    image = ps.read_hidden_image(ps.find_image("mushroom"), PUBLISHED)
    own = folder / "box"
    signal = _lit(scene, image, own / "light.exr", SOLID)
    photograph = _photograph(SOLID, signal, "overcast", 10.0, scene, own)
    return _boxed(SOLID, 10.0, photograph, None, image, folder)


def chair(file: Path, folder: Path) -> Subject:
    """Return the published photograph, whose chair is known as a box about it alone."""
    size = ps.load_scenario(ps.find_scene("chair"), PUBLISHED).photograph_shape
    photograph = ps.read_photograph(file, size).values
    inside = ps.bad_border(photograph).inside(photograph.shape[:2])
    image = ps.read_hidden_image(file, PUBLISHED)
    return _boxed("published chair, real", None, photograph, inside, image, folder)


def _boxed(
    name: str,
    sbr: float | None,
    photograph: Array,
    used: Cells | None,
    image: Array,
    folder: Path,
) -> Subject:
    """Return a photograph of the chair that is known as a box of 85 x 75 x 320 mm alone."""
    shipped = ps.find_scene("chair")
    searched = folder / "box" / "searched.xml"
    box = {
        "seat_width": "0.085",
        "seat_depth": "0.075",
        "seat_thickness": "0.32",
        # From 5 mm beside the chair, and from the table.
        "occluder_dx": "-0.005",
        "occluder_dz": "0.078",
    }
    parts = (occluder.name for occluder in ps.load_scenario(shipped, (1, 1)).occluders)
    left_out = [part for part in parts if part != "chair_seat"]
    _write(searched, with_mesh(shipped, left_out[0], None, box, searched.parent))
    for part in left_out[1:]:
        _write(searched, with_mesh(searched, part, None, {}, searched.parent))
    cells = (21, 8)  # of 32 x 12 the real photograph tells too few
    known, true = (ps.load_scenario(path, PUBLISHED) for path in (searched, shipped))
    return Subject(
        name,
        "mushroom",
        sbr,
        Sought(photograph, used, searched, "chair_seat", PUBLISHED, cells),
        Truth(image, True, shipped, outline(true, known, "chair_seat", cells)),
    )


def frame(file: Path, folder: Path) -> Subject:
    """Return a photograph of another laboratory, whose frame is known as a rectangle alone."""
    here = Path(__file__).parent
    searched, hidden, cells = here / "frame.xml", (13, 22), (16, 9)
    sketched = folder / "sketch" / "true.xml"
    text = with_mesh(searched, "frame", None, {}, sketched.parent)
    sketch = (here / "frame_sketch.xml").read_text("utf-8")
    shapes = sketch[sketch.index("<shape") : sketch.rindex("</scene>")]
    _write(sketched, text.replace("</scene>", f"    {shapes}</scene>"))
    known, true = (ps.load_scenario(path, hidden) for path in (searched, sketched))
    photograph = ps.read_photograph(file, known.photograph_shape).values
    inside = ps.bad_border(photograph).inside(photograph.shape[:2])
    return Subject(
        "another laboratory's frame, real",
        "three bars",
        None,
        Sought(photograph, inside, searched, "frame", hidden, cells),
        Truth(_shown(file), False, sketched, outline(true, known, "frame", cells)),
    )


def outline(true: Scenario, known: Scenario, shape: str, cells: tuple[int, int]) -> Cells:
    """Return where the parts of a true scene, each convex, are within a shape's rectangle.

    They are projected along the way from the middle of the monitor to that of the wall.
    """
    from scipy.spatial import ConvexHull

    plane = mask_plane(known, shape)
    rows, offsets = plane.rows_of_projection()
    way = rows @ (known.patch_centers.mean(axis=0) - known.wall_points.mean(axis=0))
    down, across = ((np.arange(n * FINE) + 0.5) / (n * FINE) for n in cells)
    points = np.stack(np.meshgrid(across, down), axis=-1)
    inside = np.zeros(points.shape[:2], bool)
    for occluder in true.occluders:
        assert occluder.vertices is not None  # boxes and rectangles
        at = occluder.vertices @ rows.T + offsets
        hull = ConvexHull((at - at[:, 2:] * way / way[2])[:, :2]).equations
        inside |= (points @ hull[:, :2].T + hull[:, 2] <= 0).all(axis=-1)
    return inside


def _write(path: Path, text: str) -> None:
    with staged_file(path) as file:
        file.write_text(text, encoding="utf-8")


def _shown(file: Path) -> Array:
    """Return what a monitor was sent, the array `shown` of an NPZ file, as linear light."""
    if file.suffix != ".npz":
        raise PhotographError(f"{file}: is no NPZ file with the arrays 'photograph' and 'shown'")
    with np.load(file) as held:
        if "shown" not in held.files:
            raise PhotographError(f"{file}: has no array 'shown', what the monitor was sent")
        try:
            shown = held["shown"]
        except (ValueError, EOFError, BadZipFile, zlib.error) as error:  # objects, or damage
            raise PhotographError(f"{file}: 'shown' cannot be read as numbers") from error
    if shown.dtype != np.uint8 or shown.ndim != 3 or shown.shape[2] != 3:
        raise PhotographError(
            f"{file}: 'shown' has shape {shown.shape} and type {shown.dtype}; give (R, C, 3) uint8"
        )
    return np.asarray(srgb_decode(shown / 255.0))


def _lit(scene: Scenario, image: Array, file: Path, name: str) -> Array:
    """Render the monitor's light on the wall, (rows, columns, 3), or read the file that holds it.

    All bounces: what bounces is the difference of two path tracings by the same paths.
    """
    made = as_text(provenance(scene.path, ps.use_variant(), SEED, [], scene.parameters))
    depends = {
        "scene_sha256": made["scene_sha256"],
        # How its last bits are rounded, other threads or processors do not say alike.
        "truth_sha256": array_sha256(np.round(image, 6)),
        "rays": str((RAYS, PATHS)),
        "seed": str(SEED),
    }

    def half(seed: int) -> Array:
        A = ps.render_transport(scene, samples=RAYS[0], pixel_samples=RAYS[1], seed=seed)
        straight = (A @ image.reshape(-1, 3)).reshape(*scene.photograph_shape, 3)
        every, first = (
            ps.render_photograph(
                scene, image, samples=PATHS, bounces=bounces, only_monitor=True, seed=seed
            )
            for bounces in (None, 1)
        )
        return np.asarray(straight * scene.channel_gain + every - first)

    def render() -> Array:
        halves = [half(SEED + k) for k in range(2)]
        grain = np.std(halves[1] - halves[0]) / 2 / np.sqrt(np.mean(halves[0] ** 2))
        print(f"{name}: rendered to a grain of {100 * grain:.3f} %", flush=True)
        return np.asarray(np.mean(halves, axis=0))

    return kept(file, depends, render, made)
