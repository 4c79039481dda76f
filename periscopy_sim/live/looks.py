"""What the page draws of a laboratory: panels of pictures, its things in 3-D, handles on them.

No names say which parameter moves what: a small change of each shows it.
"""

from base64 import b64encode
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from periscopy_sim.calibration.prior import declared_errors
from periscopy_sim.errors import SceneError
from periscopy_sim.figures import panels, style
from periscopy_sim.live.pictures import LivePictures
from periscopy_sim.numerics import Array
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import CALIBRATED, HIDDEN, Occluder

SLIDER = {"errors": 10.0, "metres": 0.1, "steps": 200}
"""Reach to either side, in standard errors of the prior, farther than anyone calibrates, or, where
the scene declares none, in metres by which places move; least steps from the middle to an end."""

Arrays = Mapping[str, Array]
Numbers = Mapping[str, float]


@dataclass(frozen=True)
class Movable:
    """A number that a scene declares, and the range and the steps in which a person moves it."""

    name: str
    value: float
    low: float
    high: float
    step: float
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Handle:
    """A thing at `center`, (3,), in metres, that some parameters shift: drag it, and they follow.

    `directions`, (K, 3), are the metres that it moves per unit of the K parameters `names`, which
    have the values `start`, (K,), at its centre.
    """

    name: str
    names: tuple[str, ...]
    directions: Array
    center: Array
    start: Array

    def position(self, values: Mapping[str, float]) -> Array:
        """Return where it is, (3,), at some values."""
        moved = np.array([values[name] for name in self.names]) - self.start
        return np.asarray(self.center + moved @ self.directions)

    def values(self, position: Array) -> dict[str, float]:
        """Return the values that bring it nearest to a position, (3,)."""
        moved = np.linalg.lstsq(self.directions.T, position - self.center, rcond=None)[0]
        return dict(zip(self.names, (self.start + moved).tolist(), strict=True))


def find_movables(scenario: Scenario) -> tuple[tuple[Movable, ...], tuple[Handle, ...]]:
    """Return the movable parameters of a scene, in the file's order, and its handles.

    Numbers that no neighbour can replace, such as whole ones, and those that change the
    photograph's size are left out. A SceneError says that nothing can be moved.
    """
    document, parts = scenario.document, parts_of(scenario)
    errors, movables = declared_errors(document), list[Movable]()
    moves = dict[frozenset[str], dict[str, Array]]()  # by parts: what shifts them, metres per unit
    for name, text in document.values.items():
        if name in document.errors or name == CALIBRATED:
            continue
        try:
            value = float(text)
            nudge = 1e-3 * (abs(value) or 1.0)
            nudged = scenario.at(**{name: f"{value + nudge:.17g}"})
        except (ValueError, SceneError):
            continue
        if nudged.photograph_shape != scenario.photograph_shape:
            continue
        speeds = {
            part: (points - parts[part]) / nudge
            for part, points in parts_of(nudged).items()
            if part in parts and points.shape == parts[part].shape
            and not np.allclose(points, parts[part], rtol=0, atol=1e-7)  # single precision
        }  # fmt: skip
        every = np.concatenate([*speeds.values(), np.zeros((0 if speeds else 1, 3))])
        shift, fastest = every.mean(axis=0), float(np.linalg.norm(every, axis=1).max())
        rounding = 1e-3 * np.linalg.norm(shift)
        if is_place := bool(speeds) and np.abs(every - shift).max() <= rounding:
            shift[np.abs(shift) < rounding] = 0  # rounding would turn the handle
            moves.setdefault(frozenset(speeds), {})[name] = shift
        limits = _limits(value, errors.get(name, 0.0), fastest, is_place=bool(is_place))
        # The unit of a number that scales a shape may be metres or not.
        movables.append(Movable(name, value, *limits, document.units.get(name, "")))
    if not movables:
        raise SceneError(
            f"scene '{scenario.path}' declares nothing that can be moved; declare a number, such "
            'as <default name="occluder_dx" value="0"/>, and use it as $occluder_dx'
        )
    values = {each.name: each.value for each in movables}
    # A subset of another set of parts has no handle: it would stand in the other's way.
    sets = [group for group in moves if not any(group < other for other in moves)]
    return tuple(movables), tuple(_handle(group, moves[group], values, parts) for group in sets)


def parts_of(scenario: Scenario) -> dict[str, Array]:
    """Return points, (n, 3), of the parts of a scene, by name."""
    occluders = scenario.view.occluders
    shapes = {o.name: o.bounds if o.vertices is None else o.vertices for o in occluders}
    surfaces = {name: surface.centers for name, surface in scenario.hidden.items()}
    parts = {"camera": scenario.view.centers, **surfaces, **shapes}
    return {name: points for name, points in parts.items() if points is not None}


def _limits(
    value: float, error: float, fastest: float, *, is_place: bool
) -> tuple[float, float, float]:
    """Return the ends of a range of whole decimal steps, which keeps a size positive, and the step.

    The range follows from the prior's error, or from how fast things move, in metres per unit.
    """
    if np.isfinite(error) and error > 0:
        reach = SLIDER["errors"] * error
    elif value and not is_place:
        reach = abs(value) / 2
    else:
        reach = SLIDER["metres"] / fastest if fastest else 1.0
    step = float(10.0 ** np.floor(np.log10(reach / SLIDER["steps"] * 1.001)))
    low = value - reach if is_place or value <= 0 else max(value - reach, value / 10)
    low, high = (
        float(f"{value + step * round((end - value) / step):.12g}") for end in (low, value + reach)
    )
    return low, high, step


def _handle(group: frozenset[str], shifts: Arrays, values: Numbers, parts: Arrays) -> Handle:
    """Return the handle of a set of parts that some parameters shift together."""
    points = np.concatenate([parts[name] for name in sorted(group)])
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    start = np.array([values[name] for name in shifts])
    heads = (name.removeprefix(f"{HIDDEN}_").split("_")[0] for name in sorted(group))
    title = " + ".join(dict.fromkeys(heads))
    return Handle(title, tuple(shifts), np.array(list(shifts.values())), center, start)


LINES = 17
"""Rows and columns of points, at most, by which a surface is drawn."""

AHEAD = 0.002
"""Metres from the wall to the photograph in front of it, and to its picture behind it."""

MARGIN = 0.1
"""Over the size of everything: what wall and floor reach beyond, and the length of arrows."""

Pixels = NDArray[np.uint8]
"""A picture, (rows, columns, 3 or 4) sRGB; the page hatches what is transparent."""


Panel = Mapping[str, Any]
"""What `page.js` draws: pictures side by side, on one scale, and the text beneath them."""


def _panel(
    caption: str, pictures: Iterable[Pixels] = (), scale: tuple[str, str, str] | None = None
) -> Panel:
    """Return a panel; the scale of false colours is matplotlib's colormap, and its ends as text."""
    shown = [{"source": as_source(each), "columns": each.shape[1]} for each in pictures]
    panel: dict[str, Any] = {"caption": caption, "pictures": shown}
    if scale is not None:
        name, low, high = scale
        colours = [f"#{bytes(c).hex()}" for c in _colours(name, np.linspace(0, 1, 9))[:, :3]]
        panel["scale"] = {"colours": colours, "low": low, "high": high}
    return panel


def as_source(pixels: Pixels) -> str:
    """Return a picture as the address of an image in a page."""
    file = BytesIO()
    Image.fromarray(pixels).save(file, "PNG", compress_level=1)  # of 30 a second
    return f"data:image/png;base64,{b64encode(file.getvalue()).decode()}"


def photograph_pixels(pictures: LivePictures) -> Pixels:
    """Return the photograph for display; masked pixels are transparent."""
    used = pictures.photograph.pixels[..., np.newaxis]
    return _bytes(panels.encoded(np.where(used, pictures.photograph.values, np.nan), None))


def hidden_pixels(pictures: LivePictures) -> dict[str, Pixels]:
    """Return images for display by surface; the reconstructions if they are unknown."""
    is_known = pictures.truth is not None
    images = pictures.scenario.hidden.images(pictures.truth if is_known else pictures.image)
    white = 1.0 if is_known else panels.common_white(images.values())
    return {name: _bytes(panels.encoded(image, white)) for name, image in images.items()}


def _bytes(picture: Array) -> Pixels:
    return np.rint(255 * picture).astype(np.uint8)


def panels_of(pictures: LivePictures) -> list[Panel]:
    """Return the panels: photograph, reconstruction, and what is known of their errors.

    The frames of a stream have no standard errors, and no panel of them.
    """
    choice, (rows, columns) = pictures.choice, pictures.photograph.shape
    caption = f"Photograph: {rows} x {columns} pixels"
    if pictures.report.residual is None:
        caption += f"{f', SBR {choice.sbr:g}' if choice.place else ''}, {choice.snr:g} dB"
    sizes = {n: "{} x {}".format(*shape) for n, shape in pictures.scenario.hidden.shapes.items()}
    each = sizes.values() if len(sizes) == 1 else map(" ".join, sizes.items())
    psnr = "" if pictures.psnr is None else f", PSNR {pictures.psnr:.1f} dB"
    found = f"Reconstruction: {', '.join(each)} patches{psnr}"
    return [
        _panel(caption, [photograph_pixels(pictures)]),
        _panel(found, hidden_pixels(replace(pictures, truth=None)).values()),
        _third(pictures),
        *([] if pictures.frame is not None else [_errors(pictures)]),
    ]


def _third(pictures: LivePictures) -> Panel:
    """Return the residual of a given photograph, or else the hidden image."""
    residual = pictures.report.residual
    if residual is None:
        shown = [] if pictures.truth is None else hidden_pixels(pictures).values()
        return _panel("Hidden image", shown)
    caption = f"Unexplained: {100 * residual.unexplained:.2f} %"
    if residual.noise_alone is not None:
        between = "alone" if pictures.frame is None else "between frames"
        caption += f", noise {between} {100 * residual.noise_alone:.2f} %"
    light, bound, unit = panels.residual_map(residual)
    unit = unit.replace("standard deviations of noise", "σ of noise").partition(" of the")[0]
    scale = "RdBu_r", f"−{bound:.2g} {unit}", f"+{bound:.2g} {unit}"
    return _panel(caption, [_colours("RdBu_r", light / bound / 2 + 0.5)], scale)


def _errors(pictures: LivePictures) -> Panel:
    errors, hidden = pictures.report.standard_errors, pictures.scenario.hidden
    if errors is None:
        return _panel(f"Standard error: {pictures.choice.method} reports none")
    white = float(np.percentile(hidden.vector(pictures.image), 99)) or 1.0
    percent = 100 / white * np.sqrt(np.mean(hidden.vector(errors) ** 2, axis=1))
    counted = "noise and scene" if pictures.report.numbers.get("standard_errors_count") else "noise"
    median, largest = (float(f"{each(percent):.2g}") for each in (np.median, np.max))
    caption = f"Standard error ({counted}): median {median:g}, largest {largest:g} %"
    maps = hidden.split(percent / (percent.max() or 1.0)).values()
    scale = "magma", "0 %", f"{largest:g} % of white"
    return _panel(caption, [_colours("magma", each) for each in maps], scale)


def _colours(name: str, values: Array) -> Pixels:
    """Return false colours of values in [0, 1], (..., 4); NaN is transparent."""
    return np.asarray(style.mpl.colormaps[name](values, bytes=True))


# -- the laboratory in 3-D -------------------------------------------------------------------------


def room_of(scenario: Scenario) -> dict[str, Any]:
    """Return what stays: floor, wall, first view and arrows' length."""
    points, frame = _everything(scenario), scenario.view.frame
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    width, depth, _ = high - low + MARGIN * size
    # The wall is just behind everything.
    axes = np.stack([frame.across, frame.up])
    local = (points - frame.center) @ axes.T
    left, right = local.min(axis=0) - [MARGIN * size, 0], local.max(axis=0) + MARGIN * size
    center = frame.center + (left + right) / 2 @ axes - AHEAD * frame.normal
    # The first view, of the floor's middle: from beside the viewer of the wall, and from above.
    x, y, z = back = 0.7 * frame.normal + 0.6 * frame.across + np.array([0, 0, 0.35])
    length = float(np.linalg.norm(back))
    floor = np.array([*middle[:2], low[2]])
    return {
        "wall": _rectangle(center, *((right - left)[:, np.newaxis] * axes)),
        "floor": _rectangle(floor, *np.diag([width, depth, 0])[:2]),
        "hatching": as_source(panels.hatching()),
        "arrow": MARGIN * size,
        "view": {
            "target": floor.tolist(), "distance": 0.95 * size * length,
            "azimuth": np.degrees(np.arctan2(y, x)), "elevation": np.degrees(np.arcsin(z / length)),
        },
    }  # fmt: skip


def images_in(pictures: LivePictures) -> dict[str, Any]:
    """Return the photograph on a scene's wall, and the images on hidden surfaces."""
    scenario, images = pictures.scenario, hidden_pixels(pictures)
    on_wall = scenario.view.surface.vertices + AHEAD * scenario.view.frame.normal
    return {
        "photograph": _on_grid(photograph_pixels(pictures), on_wall),
        "hidden": [_on_grid(images[name], each.vertices) for name, each in scenario.hidden.items()],
    }


def _on_grid(pixels: Pixels, corners: Array) -> dict[str, Any]:
    """Return an image and some of its pixels' corners, (rows, columns, 3), from the upper left."""
    lines = (np.linspace(0, n - 1, min(n, LINES)).round().astype(int) for n in corners.shape[:2])
    return {"source": as_source(pixels), "grid": corners[np.ix_(*lines)].tolist()}


def _rectangle(center: Array, across: Array, up: Array) -> Any:
    """Return the corners of a rectangle, from the upper left."""
    return [[(center + x * across + y * up).tolist() for x in (-0.5, 0.5)] for y in (0.5, -0.5)]


def mesh_of(occluder: Occluder) -> dict[str, Any]:
    """Return the triangles of an occluder, each vertex to 10 micrometres."""
    vertices, faces = occluder.vertices, occluder.faces
    if vertices is None or faces is None:  # no mesh: the box about it
        from trimesh.creation import box

        around = box(bounds=occluder.bounds)
        vertices, faces = np.asarray(around.vertices), np.asarray(around.faces)
    shown = np.round(np.asarray(vertices, float), 5)
    return {"vertices": shown.ravel().tolist(), "faces": faces.ravel().tolist()}


def _everything(scenario: Scenario) -> Array:
    """Return the points, (n, 3), of all but far surroundings."""
    seen_and_hidden = np.concatenate([scenario.view.centers, scenario.hidden.centers])
    reach = np.linalg.norm(np.ptp(seen_and_hidden, axis=0))
    parts = parts_of(scenario).values()
    return np.concatenate([p for p in parts if np.linalg.norm(np.ptp(p, axis=0)) <= reach])
