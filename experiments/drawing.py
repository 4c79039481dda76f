"""How the figures look: sizes and colours that suit a paper's column and every reader's eyes."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from experiments.report import Picture
from periscopy_sim.figures import style
from periscopy_sim.figures.panels import Rows, draw_panels
from periscopy_sim.figures.style import PAGE as PAGE
from periscopy_sim.scenario import Scenario
from periscopy_sim.view import wall_frame

COLORS = {
    # In one figure each colour stands for one thing.
    "preconditioned": style.OKABE_ITO[0],
    "differencing": style.OKABE_ITO[1],
    "truncated-svd": style.OKABE_ITO[3],
    "noise-aware": style.OKABE_ITO[2],
    "pseudoinverse": style.OKABE_ITO[2],
    "bound": style.OKABE_ITO[6],
}


@contextmanager
def drawn(out: Path, name: str, width: float, height: float) -> Iterator[Any]:
    """Yield a matplotlib figure of a size in inches; save it as PNG and PDF."""
    out.mkdir(parents=True, exist_ok=True)
    with style.drawn(out / f"{name}.png") as figure:
        figure.set_size_inches(width, height)
        yield figure
        figure.savefig(out / f"{name}.pdf", metadata={"CreationDate": None})


def draw_rows(out: Path, name: str, rows: Rows, caption: str) -> Picture:
    """Draw linear pictures in [0, 1], each under its title, in rows by their names."""
    draw_panels(out / f"{name}.png", rows)
    return Picture(out / f"{name}.png", caption)


def wall_extent(scenario: Scenario) -> tuple[float, float, float, float]:
    """Return the field of view on the wall for imshow: left, right, bottom, top, in millimetres.

    They count from its centre and reach half a pixel beyond the outermost pixels' centres.
    """
    rows, columns = scenario.photograph_shape
    frame = wall_frame(scenario.view.centers, scenario.view.center_normals, (rows, columns))
    offsets = 1e3 * (scenario.view.centers - frame.center)
    x, z = offsets @ frame.across, offsets @ frame.up
    half_x, half_z = np.ptp(x) / (columns - 1) / 2, np.ptp(z) / (rows - 1) / 2
    left, right = float(x.min() - half_x), float(x.max() + half_x)
    return left, right, float(z.min() - half_z), float(z.max() + half_z)
