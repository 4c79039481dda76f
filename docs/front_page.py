"""Draw the pictures of the front page: `python docs/front_page.py CAPTURE.npz`.

`schematic.png` is the shipped chair scene, by the geometry that `periscopy draw` shows; `real.png`
is a published capture, of `periscopy fetch saunders2019-chair`, its reconstruction, and another by
the scene and the colours that are calibrated with the picture known.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.collections import PolyCollection
from matplotlib.transforms import Affine2D

import periscopy_sim as ps
from periscopy_sim.figures.laboratory import RoomPlan
from periscopy_sim.figures.panels import draw_panels
from periscopy_sim.figures.style import OKABE_ITO, PAGE, drawn

DOCS = Path(__file__).parent
TURN, TILT = np.radians(24), np.radians(27)
"""Angles from which the laboratory is seen: to its right, and downwards."""

CAMERA = np.array([1.32, 0.28, 0.30])
CORNER = np.array([[0.90, -0.16, 0], [0.90, 0.42, 0], [0.90, 0.42, 0.52], [0.90, -0.16, 0.52]])
"""Where a camera and the corner would stand; the scene's own camera looks squarely at the wall."""


CREDIT = "Capture: Saunders, Murray-Bruce and Goyal, Nature 565 (2019)"


def flat(points: Any) -> Any:
    """Return points, (n, 3) in metres, as the drawing shows them, (n, 2)."""
    x, y, z = np.asarray(points, float).T
    across, away = x * np.cos(TURN) - y * np.sin(TURN), x * np.sin(TURN) + y * np.cos(TURN)
    return np.stack([across, z * np.cos(TILT) + away * np.sin(TILT)], axis=-1)


def put(ax: Any, image: Any, corner: Any, right: Any, up: Any, depth: float) -> None:
    """Show an image, top row first, on a parallelogram of the laboratory."""
    origin, u, v = flat([corner, np.add(corner, right), np.add(corner, up)])
    u, v = u - origin, v - origin
    place = Affine2D(np.array([[u[0], v[0], origin[0]], [u[1], v[1], origin[1]], [0, 0, 1]]))
    ax.imshow(
        ps.to_srgb(image), extent=(0, 1, 0, 1), transform=place + ax.transData, zorder=depth,
        interpolation="bilinear",
    )  # fmt: skip


def draw_schematic(path: Path) -> None:
    """Draw wall, chair, monitor, camera and the corner between."""
    scene = ps.load_scenario("chair", (29, 36))
    truth = ps.read_hidden_image(ps.find_image("mushroom"), (29, 36))
    plan = RoomPlan(scene)
    survey, blue, orange = plan.survey, OKABE_ITO[0], OKABE_ITO[1]
    photograph = (ps.analytic_transport(scene) @ truth.reshape(-1, 3)).reshape(126, 126, 3)
    low, high = survey.view_points[:4].min(axis=0), survey.view_points[:4].max(axis=0)
    wall = [[-0.15, 1.03, 0], [1.45, 1.03, 0], [1.45, 1.03, 0.62], [-0.15, 1.03, 0.62]]
    floor = [[-0.15, -0.16, 0], [1.45, -0.16, 0], [1.45, 1.03, 0], [-0.15, 1.03, 0]]
    monitor = survey.corners["monitor"].reshape(-1, 3)
    left, right = monitor.min(axis=0), monitor.max(axis=0)
    with drawn(path) as figure:
        figure.set_size_inches(PAGE, 4.4)
        ax = figure.subplots()
        ax.set_axis_off()
        for outline, colour, depth in ((floor, "0.94", 0), (wall, "0.985", 1)):
            ax.add_patch(_polygon(outline, colour, "0.75", depth))
        span = high - low
        put(ax, photograph, low, [span[0], 0, 0], [0, 0, span[2]], 2)
        corners = np.array([low, [high[0], low[1], low[2]], high, [low[0], low[1], high[2]]])
        ax.add_patch(_polygon(corners, "none", blue, 3, 1.2))
        for corner in corners:
            ax.plot(*flat([CAMERA, corner]).T, color=blue, linewidth=0.5, zorder=3)
        chair = [solid for solid in plan.standing() if solid.name.startswith("chair")]
        for point in corners[[0, 2]]:
            ax.plot(*flat([(left + right) / 2, point]).T, color=orange, lw=0.7, ls="--", zorder=3)
        faces = [face for solid in chair for face in solid.points[solid.faces]]
        faces.sort(key=lambda face: -(face @ [np.sin(TURN), np.cos(TURN), -0.5]).mean())
        normals = [np.abs(np.cross(face[1] - face[0], face[2] - face[0])) for face in faces]
        greys = [str(0.2 + 0.12 * (2 * n[2] + n[0]) / n.sum()) for n in normals]
        look: dict[str, Any] = {"facecolor": greys, "edgecolor": greys, "linewidth": 0.4}
        ax.add_collection(PolyCollection([flat(face) for face in faces], zorder=4, **look))
        ax.add_patch(_polygon(CORNER, "0.8", "0.5", 5))
        put(ax, truth[:, ::-1], left, [right[0] - left[0], 0, 0], [0, 0, right[2] - left[2]], 6)
        screen = [left, [right[0], 0, left[2]], right, [left[0], 0, right[2]]]
        ax.add_patch(_polygon(screen, "none", orange, 7, 1.5))
        ax.plot(*flat([CAMERA]).T, "s", color=blue, markersize=9, zorder=8)
        for text, place, colour in (
            ("monitor with the hidden image", [0.23, 0, 0.06], orange),
            ("the chair\ncasts soft\nshadows", [0.948, 0.87, 0.012], "0.2"),
            ("blank wall; the camera\nsees this square", [0.20, 1.03, 0.36], blue),
            ("camera", CAMERA - [0, 0, 0.075], blue),
            ("corner", [0.90, 0.13, 0.27], "0.25"),
        ):
            x, y = flat([place])[0]
            ax.text(x, y, text, color=colour, ha="center", va="center", fontsize=12, zorder=10)
        ax.set(aspect="equal")
        ax.margins(0.01)
        ax.autoscale_view()
        rcParams["savefig.dpi"] = 180  # until `drawn` ends


def _polygon(points: Any, face: str, edge: str, depth: float, width: float = 0.8) -> Any:
    from matplotlib.patches import Polygon

    return Polygon(flat(points), facecolor=face, edgecolor=edge, linewidth=width, zorder=depth)


def draw_real(path: Path, capture: Path) -> None:
    """Draw a picture, its photograph, and what the default method makes of it by two scenes."""
    shape = 29, 36
    ruler = ps.load_scenario("chair", shape)
    photograph = ps.read_photograph(capture, ruler.photograph_shape).values
    truth = ps.read_hidden_image(capture, shape)
    calibration = ps.calibrate(photograph, "chair", shape, shown=[truth])
    pictures = {"shown by the monitor": truth, "photograph": photograph / photograph.max()}
    for title, scene, colours in (
        ("with ruler measurements", ruler, None),
        (
            "calibrated with\nthe picture known",
            ruler.at(**calibration.values),
            ps.ColourMatrix(calibration.colour_matrix),
        ),
    ):
        A, B = ps.analytic_transport(scene), ps.point_light_backgrounds(scene)
        given = ps.Photograph.of(photograph, colour_matrix=colours)
        image = ps.NoiseAware.for_scene(scene, A, B).reconstruct(given)
        shifted = ps.registered(image, truth)
        unshifted = ps.psnr_gain_matched(image, truth)
        print(f"{unshifted:.1f} dB, {shifted.psnr:.1f} dB shifted by {shifted.shift}")
        pictures[title] = image / np.percentile(image, 99.5)
    panels = [(title, np.clip(each, 0, 1)) for title, each in pictures.items()]
    draw_panels(path, panels, caption=CREDIT)


if __name__ == "__main__":
    draw_schematic(DOCS / "schematic.png")
    if len(sys.argv) > 1:
        draw_real(DOCS / "real.png", Path(sys.argv[1]))
