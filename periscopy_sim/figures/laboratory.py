"""A laboratory's wall, plan and side view, to scale, with the names and measures of its things."""

from collections import Counter
from collections.abc import Iterable
from itertools import pairwise
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.figures.space import show_space
from periscopy_sim.figures.style import NO_BREAK, OKABE_ITO, PAGE, STYLE, mpl
from periscopy_sim.numerics import Array, validation
from periscopy_sim.rendering.survey import Solid, Survey
from periscopy_sim.rendering.variant import require_vectorized
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import MONITOR
from periscopy_sim.shipped import find_image
from periscopy_sim.storage.pictures import read_hidden_image

if TYPE_CHECKING:
    from periscopy_sim.figures.style import Figure

FARTHEST = 4.0
"""Times the size of camera, monitor and view, from their middle, up to which occluders that are
smaller than this size are in sight; of larger ones, such as a floor, up to one size."""

COVERING = 0.15
"""Fraction of a panel; a thing that covers more is drawn as its ground."""

FLAT = 0.9999
"""Length of the mean normal of a surface that counts as flat; a curved one has a shorter."""

TOUCHING = 1e-3
"""Metres from the wall up to which a thing stands on it."""


class RoomPlan:
    """A scenario's laboratory along the world's axes: across the picture, the other level one, up.

    `axes` are the three axes' numbers, `wall` the places of the two along the wall, and `others`
    those of the other two panels. Where the wall stands, the second axis runs towards it; where it
    lies, to the picture's top. Axes that are `mirrored` run the other way in the drawing. The
    wall's `normal`, the view's `middle` on it, the camera's `eye`, and the drawing's corners `low`
    and `high` are (3,).
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.survey = scenario, Survey(scenario)
        survey = self.survey
        normal = scenario.view.center_normals.mean(axis=0)
        self.normal: Array = normal / np.linalg.norm(normal)
        self.middle, self.eye = survey.view_points[4], survey.view_origins[4]
        top_left, top_right, _, bottom_left, _ = survey.view_points
        self.lies = bool(np.abs(normal[2]) > np.abs(normal[:2]).max())
        facing = top_left - bottom_left if self.lies else -normal
        rightwards = top_right - top_left
        # The level axis that runs along the picture, or else the one that does not face the wall.
        across = int(np.argmax(np.abs(rightwards[:2] if self.lies else normal[1::-1])))
        self.axes = across, 1 - across, 2
        self.wall, *self.others = (
            [(0, 1), (0, 2), (1, 2)] if self.lies else [(0, 2), (1, 2), (0, 1)]
        )
        self.mirrored = np.array([rightwards[across] < 0, facing[1 - across] < 0, False])
        hidden = np.concatenate([each.reshape(-1, 3) for each in survey.corners.values()])
        core = np.concatenate([survey.view_origins, survey.view_points, hidden])
        size = float(np.max(np.ptp(core, axis=0)))
        middle = (core.min(axis=0) + core.max(axis=0)) / 2
        points = core
        for each in (solid.points for solid in survey.solids):
            # Large things, as floors and walls, are cut at the frame, and do not widen it.
            reach = size if np.ptp(each, axis=0).max() > size else FARTHEST * size
            if np.abs(each - middle).max() < reach:
                points = np.concatenate([points, each])
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.09 * float(np.max(high - low))
        self.low, self.high = low - margin, high + margin

    def occluders(self) -> dict[str, Array]:
        """Return the middle of each occluder that stands off the wall, (3,), by name."""
        middles = {}
        for name, points in groups_of(self.standing()).items():
            if ((points - self.middle) @ self.normal).min() > TOUCHING:
                middles[name] = (points.min(axis=0) + points.max(axis=0)) / 2
        return middles

    def distance(self, point: Array) -> float:
        """Return how far a point, (3,), is from the wall's plane."""
        return float((point - self.middle) @ self.normal)

    def standing(self, *panels: tuple[int, int]) -> list[Solid]:
        """Return the solids that cover little of every panel, unlike tables, floors and walls.

        A panel shows two of the axes, by their places; without any, `others`.
        """

        def is_small(solid: Solid) -> bool:
            ends = np.clip(
                [solid.points.min(axis=0), solid.points.max(axis=0)], self.low, self.high
            )
            part = ((ends[1] - ends[0]) / (self.high - self.low))[[*self.axes]]
            return all(part[h] * part[v] < COVERING for h, v in panels or self.others)

        return list(filter(is_small, self.survey.solids))


def groups_of(solids: Iterable[Solid]) -> dict[str, Array]:
    """Return points of the solids by name; solids whose names share their first word are one."""
    points = {solid.name: solid.points for solid in solids}
    count = Counter(name.partition("_")[0] for name in points)
    groups: dict[str, list[Array]] = {}
    for name, each in points.items():
        stem = name.partition("_")[0]
        groups.setdefault(stem if count[stem] > 1 and stem not in points else name, []).append(each)
    return {name: np.concatenate(parts) for name, parts in groups.items()}


def facts(layout: RoomPlan) -> list[str]:
    """Return sentences of distances and sizes."""
    scenario, survey, normal = layout.scenario, layout.survey, layout.normal
    corners = survey.view_points[:4]
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    sight = layout.eye - layout.middle
    away = float(np.linalg.norm(sight))
    slant = np.degrees(np.arccos(np.clip(sight @ normal / away, -1, 1)))
    where, aim = "parallel rays (a rectified picture of the wall)", ""
    if not survey.parallel:
        where = f"{in_words(away)} from the wall along its line of sight"
        aim = "" if layout.lies else f" ({turn_and_tilt(-sight, -normal)})"
    lines = [
        f"Camera: {where}, {slant:.0f}° off its normal{aim}; sees "
        f"{in_words((sides[0] + sides[2]) / 2)} x {in_words((sides[1] + sides[3]) / 2)} of it.",
    ]
    flat = []
    for name, surface in scenario.hidden.items():
        (rows, columns), known = surface.shape, "Monitor" if name == MONITOR else name
        facing = surface.normals.mean(axis=0)
        if np.linalg.norm(facing) < FLAT:  # its distance may be a choice, so none is printed
            lines.append(f"{known}: curved.")
            continue
        wide = columns * np.linalg.norm(surface.across, axis=1).mean()
        high = rows * np.linalg.norm(surface.up, axis=1).mean()
        before = layout.distance(surface.centers.mean(axis=0))
        flat.append((before, wide, high))
        turned = turn_and_tilt(facing, -normal)
        if layout.lies:
            turned = f"{np.degrees(np.arccos(np.clip(-facing @ normal, -1, 1))):.0f}°"
        lines.append(
            f"{known}: {in_words(wide)} x {in_words(high)}, {in_words(before)} from the wall, "
            f"{turned} from facing it squarely."
        )
    if not layout.lies:
        lines.append(
            "Positive turns are counterclockwise as seen from above, positive tilts upwards."
        )
    distances = []
    before, wide, high = flat[0] if flat else (np.inf, 0, 0)
    for name, middle in layout.occluders().items():
        if (distance := layout.distance(middle)) < before:
            # By similar triangles an edge at d before the wall, of a monitor at D, casts a penumbra
            # d / (D - d) times as wide as the monitor.
            stretch = distance / (before - distance)
            penumbra = f" ({in_words(wide * stretch, 2)} x {in_words(high * stretch, 2)})"
            own = f"{name} {in_words(distance)}{penumbra if flat else ''}"
            distances.append(own.replace(" ", NO_BREAK))
    if distances:
        what = " (and width x height of the penumbra of an edge)" if flat else ""
        lines.append(f"Distance of occluders from the wall{what}: {', '.join(distances)}.")
    return lines


def turn_and_tilt(direction: Array, ahead: Array) -> str:
    """Return the angles by which a direction is turned and tilted from another, in words.

    The turn is about the vertical, counterclockwise from above, the tilt upwards from there.
    """
    turn = np.arctan2(direction[1], direction[0]) - np.arctan2(ahead[1], ahead[0])
    tilts = [np.arctan2(each[2], np.hypot(each[0], each[1])) for each in (direction, ahead)]
    angles = (np.degrees(turn) + 180) % 360 - 180, np.degrees(tilts[0] - tilts[1])
    turned, tilted = (round(float(angle), 1) + 0.0 for angle in angles)
    return f"turned {turned:g}°, tilted {tilted:g}°"


def in_words(length: float, digits: int = 3) -> str:
    """Return a length, in metres, as a person writes it."""
    if 0 < length < 0.00995:
        return f"{1000 * length:.{digits}g} mm"
    return f"{length:.2f} m" if length >= 0.995 else f"{100 * length:.{digits}g} cm"


def border(corners: Array) -> Array:
    """Return the border, (n, ...), of a grid of points, (rows, columns, ...), once around it."""
    sides = corners[0, :-1], corners[:-1, -1], corners[-1, :0:-1], corners[:0:-1, 0]
    return np.concatenate(sides)


def hull(points: Array) -> Array:
    """Return the corners of the convex hull of points in a plane; of a line its two ends."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return extremes(points)


def extremes(points: Array) -> Array:
    """Return the two of points in a plane, (n, 2), that lie farthest out along their length."""
    values, axes = np.linalg.eigh(np.cov(points.T))
    along = (points - points.mean(axis=0)) @ axes[:, np.argmax(values)]
    return np.asarray(points[[np.argmin(along), np.argmax(along)]])


GAPS = 9.0, 36.0, 72.0, 120.0
"""Pixels between a thing and its label, the nearest first."""


class Labels:
    """The labels of one panel; `place` them once everything is drawn.

    The panel stays from `low` to `high`, (2,) each, whatever is drawn meanwhile.
    """

    def __init__(self, ax: Any) -> None:
        self._ax, self._limits = ax, (ax.get_xlim(), ax.get_ylim())
        self.low, self.high = np.sort(self._limits).T
        self._labels: list[tuple[str, Array, str]] = []
        self._avoided: list[Array] = []

    def add(self, text: str, points: Array, colour: str, *, hollow: bool = False) -> None:
        """Name the thing at points (n, 2), in the panel's coordinates, if it is in sight.

        Other labels may stand within a hollow thing.
        """
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        if (high > self.low).all() and (low < self.high).all():
            self._labels.append((text, points, colour))
            if not hollow:
                self._avoided.append(points)

    def avoid_line(self, points: Array) -> None:
        """Keep labels off the line through points (n, 2): a label that it strikes is illegible."""
        for start, end in pairwise(points):
            self._avoided += [place[None] for place in np.linspace(start, end, 80)]

    def place(self) -> None:
        """Place every label: beside its thing, off all others' boxes and within the panel."""
        self._ax.set(xlim=self._limits[0], ylim=self._limits[1])
        renderer = self._ax.figure.canvas.get_renderer()
        frame = self._ax.get_window_extent(renderer)
        low, high = np.array([frame.x0, frame.y0]), np.array([frame.x1, frame.y1])

        def box(points: Array) -> Array:
            """Return the box of points in pixels, left, bottom, right, top, cut to the panel."""
            pixels = self._ax.transData.transform(points)
            ends = pixels.min(axis=0), pixels.max(axis=0)
            return np.concatenate([np.clip(end, low, high) for end in ends])

        boxes = [box(points) for points in self._avoided]
        paper = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.6}
        for text, points, colour in self._labels:
            label = self._ax.text(
                0, 0, text, transform=None, color=colour, zorder=10, ha="left", va="bottom",
                bbox=paper,
            )  # fmt: skip
            extent = label.get_window_extent(renderer)
            places = _places(box(points), np.array([extent.width, extent.height]))
            outside = (places[:, :2] < low + 2).any(axis=1) | (places[:, 2:] > high - 2).any(axis=1)
            # To stand on other things is bad, to stand outside worse than on any number of them.
            hidden = 1000 * outside + _overlaps(places, np.array(boxes)).sum(axis=1)
            best = places[np.argmin(hidden)]  # the nearest of the best
            label.set_position(tuple(best[:2]))
            boxes.append(best)


def _places(box: Array, size: Array) -> Array:
    """Return boxes, (n, 4), of a label about a thing's box: beside, above, below, then farther."""
    middle, start, end = (box[:2] + box[2:] - size) / 2, box[0], box[2] - size[0]
    corners = []
    for gap in GAPS:
        (left, below), (right, above) = box[:2] - gap - size, box[2:] + gap
        corners += [(right, middle[1]), (left, middle[1])]
        corners += [(x, y) for x in (middle[0], start, end) for y in (above, below)]
        corners += [(x, y) for y in (above, below) for x in (right, left)]
    return np.hstack([corners, corners + size])


def _overlaps(a: Array, b: Array) -> Array:
    """Return whether boxes (n, 4) and (m, 4), or points, come within some pixels, (n, m)."""
    a, b = a[:, None], b + np.array([-6, -2, 6, 2])
    sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    return np.asarray((sides > 0).all(axis=2))


VIEWED, SCREEN, *_ = OKABE_ITO
SURFACE = "#f4ceb3"  # the monitor's colour, paler
OCCLUDER, GROUND = "0.25", "0.93"

GRID = 150
"""Points of the wall along its panel's width."""

LINES = (
    "Grey: where occluders hide part of the monitor, or of what is hidden, from the wall. Dotted: "
    "where shadows begin; solid: where all of it is hidden; dashed: rays from its ends past "
    "occluders."
)
"""Meaning of the lines without a label."""


def draw_wall(ax: Any, layout: RoomPlan) -> None:
    """Show how much of the monitor each point of the wall sees, and the camera's view."""
    Polygon = mpl.patches.Polygon
    survey, (h, v) = layout.survey, (layout.axes[k] for k in layout.wall)
    labels = Labels(ax)
    (left, bottom), (right, top) = labels.low, labels.high
    x = np.linspace(left, right, GRID)
    z = np.linspace(bottom, top, max(2, round(GRID * (top - bottom) / (right - left))))
    share = _share(layout, x, z)
    ax.imshow(
        share, origin="lower", extent=(left, right, bottom, top), cmap="gray", vmin=0, vmax=1,
        interpolation="bilinear", zorder=0, alpha=2 / 3,  # full shadow stays grey, lines legible
    )  # fmt: skip
    if np.ptp(share) > 0.05:
        ax.contour(x, z, share, levels=[0.02], colors="black", linewidths=0.8)
        ax.contour(x, z, share, levels=[0.98], colors="black", linewidths=0.6, linestyles=":")
    outlines = [(survey.view_points[:4][:, [h, v]], VIEWED, "-", "seen by the camera")]
    for name, corners in survey.corners.items():
        outlines.append((border(corners)[:, [h, v]], SCREEN, "--", name))
    for outline, colour, style, text in outlines:
        ax.add_patch(Polygon(outline, fill=False, edgecolor=colour, linewidth=1.2, linestyle=style))
        labels.avoid_line(np.concatenate([outline, outline[:1]]))
        labels.add(text, outline, colour, hollow=True)
    if layout.lies:  # this is the plan, too
        solids = layout.standing(layout.wall)
        for solid in solids:
            ax.add_patch(Polygon(hull(solid.points[:, [h, v]]), fill=False, edgecolor=OCCLUDER))
        for name, points in groups_of(solids).items():
            labels.add(name, points[:, [h, v]], "black")
    labels.place()


def draw_projection(ax: Any, layout: RoomPlan, shown: tuple[int, int]) -> None:
    """Draw everything onto two axes: camera and view, monitor, occluders, shadows."""
    Polygon = mpl.patches.Polygon
    scenario, survey = layout.scenario, layout.survey
    h, v = (layout.axes[k] for k in shown)
    labels = Labels(ax)
    middle, eye, normal = layout.middle, layout.eye, layout.normal
    _draw_wall_line(ax, labels, layout, (h, v))
    seen = extremes(survey.view_points[:4][:, [h, v]])
    ax.plot(*seen.T, color=VIEWED, linewidth=3, solid_capstyle="butt", zorder=4)
    upright = layout.standing(shown)
    _draw_shadow_rays(ax, layout, (h, v))
    for solid in survey.solids:
        corners = solid.points[:, [h, v]]
        outlines = [hull(corners)] if solid.faces is None else list(corners[solid.faces])
        colour, depth = (OCCLUDER, 5.0) if solid in upright else (GROUND, 0.5)
        look: dict[str, Any] = {"facecolor": colour, "edgecolor": colour, "linewidth": 0.4}
        ax.add_collection(mpl.collections.PolyCollection(outlines, zorder=depth, **look))
    for name, points in groups_of(upright).items():
        labels.add(name, points[:, [h, v]], "black")
    size = 0.05 * float(np.sum(labels.high - labels.low))
    shortened = min(1.0, size / float(np.linalg.norm(middle - eye))) * (middle - eye)
    arrows = [(middle, size * normal, "0.45")]
    if survey.parallel:  # a rectified picture has no place from which it was taken
        labels.add("seen by the camera", seen, VIEWED)
    else:
        cone = np.concatenate([survey.view_origins[:4], survey.view_points[:4]])[:, [h, v]]
        ax.add_patch(Polygon(hull(cone), facecolor=VIEWED, alpha=0.12, linewidth=0, zorder=1))
        ax.plot(*eye[[h, v]], marker="o", markersize=5, color=VIEWED, zorder=7)
        labels.add("camera", eye[None, [h, v]], VIEWED)
        arrows.append((eye, shortened, VIEWED))
    for name, surface in scenario.hidden.items():
        corners = survey.corners[name][..., [h, v]]
        a, b, c, d = corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]
        patches = np.stack([a, b, c, d], axis=2).reshape(-1, 4, 2)
        pale: dict[str, Any] = {"facecolor": SURFACE, "antialiased": False, "linewidth": 0}
        ax.add_collection(mpl.collections.PolyCollection(patches, zorder=6, **pale))
        line = {"fill": False, "edgecolor": SCREEN, "linewidth": 2.4, "zorder": 6}
        ax.add_patch(Polygon(border(corners), **line))
        labels.add(name, corners.reshape(-1, 2), SCREEN)
        screen, facing = surface.centers.mean(axis=0), surface.normals.mean(axis=0)
        arrows.append((screen, size * facing, SCREEN))
    for start, direction, colour in arrows:
        ends = np.stack([start, start + direction])[:, [h, v]]
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 1, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", ends[1], ends[0], arrowprops=arrow, zorder=7, annotation_clip=False)
        labels.avoid_line(ends)
    labels.avoid_line(seen)
    if shown == layout.others[-1]:
        labels.add("normal", (middle + size * normal)[None, [h, v]], "0.45")
        _draw_distances(ax, labels, layout, (h, v))
    labels.place()


def _draw_distances(ax: Any, labels: Labels, layout: RoomPlan, axes: tuple[int, int]) -> None:
    """Draw how far flat hidden surfaces and occluders are from the wall, each to its middle."""
    surfaces = layout.scenario.hidden.values()
    flat = [each.centers.mean(axis=0) for each in surfaces if each.curved is None]
    ends = {in_words(layout.distance(end)): end for end in (*flat, *layout.occluders().values())}
    for words, end in ends.items():  # things at one distance have one line
        line = np.stack([end, end - layout.distance(end) * layout.normal])[:, axes]
        look = {"arrowstyle": "<->", "color": "0.45", "lw": 0.6, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", *line, arrowprops=look, zorder=6, annotation_clip=False)
        labels.add(words, line.mean(axis=0)[None], "0.25")


def _draw_wall_line(ax: Any, labels: Labels, layout: RoomPlan, axes: tuple[int, int]) -> None:
    """Draw where the wall's plane meets the panel's: through the view's middle, to the ends."""
    middle, normal = layout.middle[[*axes]], layout.normal[[*axes]]
    along = np.array([-normal[1], normal[0]]) / np.linalg.norm(normal)
    reach = float(np.sum(labels.high - labels.low))
    line = middle + np.linspace(-reach, reach, 200)[:, None] * along
    ax.plot(*line.T, color="black", linewidth=0.8, zorder=3)
    inside = line[((line > labels.low) & (line < labels.high)).all(axis=1)]
    # The label stands by the end that is farther from the view.
    far = inside[[0, -1]][np.argmax(np.linalg.norm(inside[[0, -1]] - middle, axis=1))]
    labels.add("wall", far[None], "black")
    labels.avoid_line(line[[0, -1]])


def _share(layout: RoomPlan, x: Array, z: Array) -> Array:
    """Return the share of the hidden surfaces that points of the wall's plane see, (z, x)."""
    normal, middle = layout.normal, layout.middle
    grid = np.empty((len(z), len(x), 3))
    h, v = (layout.axes[k] for k in layout.wall)
    d = 3 - h - v
    grid[..., h], grid[..., v] = x, z[:, None]
    slope = (grid[..., h] - middle[h]) * normal[h] + (grid[..., v] - middle[v]) * normal[v]
    grid[..., d] = middle[d] - slope / normal[d]  # (point - middle)·normal = 0
    points = grid.reshape(-1, 3) + 1e-4 * normal  # metres ahead, so that the wall hides nothing
    share = layout.survey.lit_share(points, layout.scenario.hidden.centers)
    return share.reshape(len(z), len(x))


def _draw_shadow_rays(ax: Any, layout: RoomPlan, axes: tuple[int, int]) -> None:
    """Draw the rays from the monitor's ends that just pass the occluders, up to the wall."""
    middle, normal = layout.middle, layout.normal
    monitor = np.concatenate([each.reshape(-1, 3) for each in layout.survey.corners.values()])
    points = np.concatenate([np.zeros((0, 3)), *(solid.points for solid in layout.standing())])
    height = (points - middle) @ normal
    before = ((monitor - middle) @ normal).min()
    points = points[(height > 1e-3) & (height < before - 1e-3)][:, axes]
    wall, facing = middle[[*axes]], normal[[*axes]]
    for end in extremes(monitor[:, axes]):
        to = points - end
        # end + t to, where (end + t to - wall)·facing = 0
        hits = end + ((wall - end) @ facing / (to @ facing))[:, None] * to
        along = hits @ np.array([-facing[1], facing[0]])
        for extreme in (np.argmin(along), np.argmax(along)) if len(along) else ():
            ray = np.stack([end, hits[extreme]])
            ax.plot(*ray.T, color="0.55", linewidth=0.6, linestyle="--", zorder=2)


SEEN = 0.35, 0.6, 0.8
"""Linear light of the part of the wall that the camera sees, in space: a pale blue."""

LARGER: Any = {
    "font.size": 12, "axes.titlesize": 12, "axes.labelsize": 12, "figure.labelsize": 12,
    "xtick.labelsize": 12, "ytick.labelsize": 12,
    "axes.spines.top": True, "axes.spines.right": True,
}  # fmt: skip
"""Letters of the drawing, of 6 points on a phone, and frames about its panels."""

CHARACTERS = 76
"""Characters of a line of text."""

TALLEST = 4.0
"""Inches that a panel may be high; the drawing is as wide as a page."""


def _show_in_space(ax: Any, scenario: Scenario) -> None:
    """Show a scene in space, on its surfaces letters, whose top and left are those of images."""
    letters, shapes = find_image("letters"), scenario.hidden.shapes.items()
    images = {name: read_hidden_image(letters, shape) for name, shape in shapes}
    show_space(ax, scenario, images, np.broadcast_to(SEEN, (*scenario.photograph_shape, 3)))
    ax.set_title("in space")


def draw(scenario: Scenario) -> "Figure":
    """Draw a scenario's laboratory to scale.

    Three views at one scale, after the third-angle projection: the front, the side view beside it,
    the plan below. The wall as the camera faces it is the front or, where it lies, the plan. Grey
    is how much of the hidden surfaces a point of the wall sees. The fourth panel shows the scene in
    space. A VariantError says that a scalar variant would take an hour.
    """
    validation.checked_scene(scenario)
    require_vectorized("a drawing")
    layout = RoomPlan(scenario)
    low, high, axes = layout.low, layout.high, [*layout.axes]
    spans = (high - low)[axes]
    spans = np.maximum(spans, spans.max() / 2)  # labels need room
    scale = min(0.86 * PAGE / (spans[0] + spans[1]), TALLEST / spans[1], TALLEST / spans[2])
    ends = (low + high)[axes] / 2 + spans * np.array([[-0.5], [0.5]])
    ends[:, layout.mirrored] = ends[::-1, layout.mirrored]
    lines = [line for each in (LINES, *facts(layout)) for line in wrap(each, CHARACTERS)]
    height = scale * (spans[1] + spans[2]) + 1.9 + 0.24 * len(lines)
    with mpl.rc_context(STYLE | LARGER):
        figure: Figure = mpl.figure.Figure(figsize=(PAGE, height), dpi=220)
        figure.set_layout_engine("constrained", h_pad=0.1)
        # Labels are placed by their size in pixels.
        mpl.backends.backend_agg.FigureCanvasAgg(figure)
        ratios: Any = {"width_ratios": spans[:2], "height_ratios": spans[:0:-1]}
        (front, side), (plan, rest) = figure.subplots(2, 2, **ratios)
        panels = {(0, 2): front, (1, 2): side, (0, 1): plan}
        titles = {(0, 2): "from the front", (1, 2): "from the side", (0, 1): "plan"}
        titles[layout.wall] = "the wall as the camera faces it"
        for (h, v), ax in panels.items():
            across, up = ("xyz"[axes[k]] for k in (h, v))
            ax.set(title=titles[h, v], xlabel=f"{across} / m", ylabel=f"{up} / m")
            ax.set(xlim=ends[:, h], ylim=ends[:, v], aspect="equal")
            ax.locator_params(nbins=5)
        front.tick_params(labelbottom=False)  # the plan below and the front beside have them
        side.tick_params(labelleft=False)
        front.set_xlabel("")
        side.set_ylabel("")
        _show_in_space(rest, scenario)
        rest.set_anchor("N")
        figure.supxlabel("\n".join(lines), x=0.06, ha="left", linespacing=1.4)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # nothing moves once labels have their places
        draw_wall(panels[layout.wall], layout)
        for shown in layout.others:
            draw_projection(panels[shown], layout, shown)
    return figure
