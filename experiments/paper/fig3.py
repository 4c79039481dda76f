"""Fig. 3: the grid of point lights whose responses on the wall are the columns of B.

Shows the wall, the camera's field of view, the 512 lights, and what two of them cast on the wall.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, wall_extent
from experiments.report import Claim, Picture, Section, Verdict
from experiments.setting import Setting
from periscopy_sim.model.transport_operator import RANK_TOLERANCE, background_basis

Array = NDArray[np.float64]

EXAMPLES = (
    ((-1.5, 1.0, 2.25), "#D55E00", "near light"),
    ((2.25, 4.0, -0.75), "#0072B2", "far light"),
)
"""Two lights of the grid: across, distance from the wall, up, in metres; colour; name."""

FACING = np.array([1, -1, 1])
"""Distances run towards the viewer."""


def run(setting: Setting) -> Section:
    """Draw the grid and two columns of B."""
    grid = ps.paper_grid()
    with drawn(setting.out, "fig3", PAGE, 2.7) as figure:
        _draw(figure, grid, setting)
    rank = background_basis(setting.B).shape[1]
    positions = [np.unique(axis).size for axis in grid.T]
    return Section(
        name="fig3",
        title="Fig. 3: point lights that sample the possible backgrounds",
        text=f"Each light's response on the wall (Eq. 4) is a column of B. The lights are far off, "
        f"so the responses are smooth and much alike: {rank} orthonormal fields hold all "
        f"{len(grid)} to {RANK_TOLERANCE:.0e} of the largest singular value.",
        claims=[
            Claim(
                "columns of B",
                "512",
                str(setting.B.shape[1]),
                Verdict.of(setting.B.shape[1] == 512),
                f"{' x '.join(map(str, positions))} positions. With both ends of the stated range "
                "a step of 75 cm gives 9 x 9 x 9 = 729: the upper ends are left out.",
            )
        ],
        pictures=[
            Picture(
                setting.out / "fig3.png",
                "The grid of point lights about the centre of the field of view (black square, "
                "0.4 m wide) on the wall (grey), and the responses of the two coloured lights "
                "within the field of view, each on its own scale.",
            )
        ],
    )


def _draw(figure: Any, grid: Array, setting: Setting) -> None:
    # Three-dimensional axes do not know their own size: all are placed by hand.
    figure.set_layout_engine("none")
    room = figure.add_axes((0.0, 0.04, 0.4, 0.94), projection="3d", computed_zorder=False)
    extent = wall_extent(setting.scenario)
    _draw_room(room, grid, extent)
    for place, (light, color, name) in zip((0.5, 0.76), EXAMPLES, strict=True):
        ax = figure.add_axes((place, 0.34, 0.215, 0.53))
        column = int(np.flatnonzero(np.isclose(grid, light).all(axis=1))[0])
        response = setting.B[:, column].reshape(setting.scenario.photograph_shape)
        picture = ax.imshow(response, cmap="cividis", extent=extent)
        across, away, up = light
        ax.set_title(f"{name}:\n({across:g}, {away:g}, {up:g}) m".replace("-", "−"), color=color)
        ax.set(xticks=(-200, 0, 200), yticks=(-200, 0, 200), xlabel="across the wall (mm)")
        for spine in ax.spines.values():
            spine.set(visible=True, color=color, linewidth=1.5)
        bar = figure.add_axes((place, 0.17, 0.215, 0.03))
        figure.colorbar(picture, cax=bar, orientation="horizontal", label="ψ (1/m²)")
        if place == 0.5:
            ax.set_ylabel("up (mm)", labelpad=-2)
        else:
            ax.set_yticklabels(())


def _draw_room(ax: Any, grid: Array, extent: tuple[float, float, float, float]) -> None:
    """Draw the room as one who faces the wall sees it; distances are negative along that axis."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    def rectangle(left: float, right: float, bottom: float, top: float) -> Array:
        return np.array([(left, 0, bottom), (right, 0, bottom), (right, 0, top), (left, 0, top)])

    field_of_view = rectangle(*(np.array(extent) / 1e3).tolist())
    ax.add_collection3d(Poly3DCollection([rectangle(-3, 3, -3, 3)], color="#d9d9d9", zorder=0))
    ax.add_collection3d(Poly3DCollection([field_of_view], color="black", zorder=1))
    ax.scatter(*(grid * FACING).T, s=2, color="#8c8c8c", depthshade=False, linewidths=0, zorder=2)
    for light, color, _ in EXAMPLES:
        across, away, up = np.array(light) * FACING
        ax.plot((0, across), (0, away), (0, up), color=color, linewidth=1, zorder=3)
        ax.scatter(across, away, up, s=28, color=color, depthshade=False, linewidths=0, zorder=4)
    ax.set(xlim=(-3, 3), ylim=(-7, 0), zlim=(-3, 3), xticks=(-3, 0, 3), zticks=(-3, 0, 3))
    ax.set_yticks((0, -2, -4, -6), ("0", "2", "4", "6"))
    ax.set_xlabel("across (m)", labelpad=-8)
    ax.set_ylabel("distance (m)", labelpad=-6)
    ax.zaxis.set_rotate_label(False)
    ax.set_zlabel("up (m)", labelpad=-10, rotation=90)
    ax.tick_params(pad=-3)
    ax.grid(visible=False)
    ax.set_box_aspect((6, 7, 6), zoom=1.0)
    ax.view_init(elev=20, azim=-55)
