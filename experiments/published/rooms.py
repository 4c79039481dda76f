"""Rooms behind a doorway, by another laboratory: how little ambient light and noise change them."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from scipy import ndimage

import periscopy_sim as ps
from experiments.published.setting import PublishedSetting
from experiments.report import Claim, Picture, Section, Table, Verdict
from periscopy_sim.figures.panels import displayable, draw_panels
from periscopy_sim.numerics import Array
from periscopy_sim.storage.published import DECODING, published_sets

SETS = "czajkowski2024-doorway"
"""Begins the names of the sets."""

SCENE, HIDDEN = "doorway", (32, 32)

BLUR = 2.0
"""Standard deviation in pixels of the Gaussian that blurs noise away."""

NOISE = 2e-3
"""Noise of the averages over their mean, about."""

PAIRS = {
    "AmbientLight/twoman1bg": "AmbientLight/twoman0bg",
    "AmbientLight/twoman2bg": "AmbientLight/twoman0bg",
    "AmbientLight/twoman3bg": "AmbientLight/twoman0bg",
    "SingleSnapshot/twoman0bg": "AmbientLight/twoman0bg",
    "SingleSnapshot/play1": "play1",
    "SingleSnapshot/work": "work",
    "SingleSnapshot/USF_man": "USF_man",
}
"""Photographs under more light, or of a single exposure, and the one that each is compared with."""

POWERS = 1.0, 1.7, 2.2, 2.6, 3.0
"""Powers of the files' values that are compared as linear light."""

OTHER_ROOMS = {"play1": "shelf_only"}
"""Photographs of one ceiling before different rooms."""


def run(setting: PublishedSetting) -> Section:
    """Reconstruct every room by default settings, and compare those of the same things."""
    photographs, problems = _photographs()
    section = Section("rooms", "Rooms behind a doorway")
    if not photographs:
        return replace(section, tables=[Table("Not read.", ("set", "why"), problems)])
    rows, images, uneven = [], dict[str, Array](), dict[str, Array]()
    for name, photograph in photographs.items():
        method = _scene(photograph.shape[:2]).method("noise-aware", noise=NOISE)
        solution = method.solve(photograph)
        images[name] = np.asarray(solution.image)
        residual = method.report(photograph, solution).residual
        assert residual is not None
        uneven[name] = np.mean(residual.light / photograph, axis=2)
        percents = (100 * (each or 0.0) for each in (residual.unexplained, residual.noise_alone))
        rows.append((name, *(f"{percent:.3f}" for percent in percents)))
    file = setting.out / "rooms.png"
    panels = {
        name: [("photograph", displayable(light)), ("image", displayable(images[name]))]
        for name, light in photographs.items()
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    draw_panels(file, panels)
    paint = "different rooms share the ceiling's paint alone"
    compared = (
        ("images", images, PAIRS, ""),
        ("residuals over the light", uneven, OTHER_ROOMS, paint),
    )
    claims = [
        Claim(
            f"correlation of {what}, {name} and {other}",
            "",
            f"{correlation(values[name], values[other]):.3f}",
            Verdict.MEASURED,
            reason,
        )
        for what, values, pairs, reason in compared
        for name, other in pairs.items()
        if name in values and other in values
    ]
    tables = [Table("Over the mean light, %.", ("photograph", "unexplained", "noise"), rows)]
    lit, dark = next(iter(PAIRS.items()))
    if lit in photographs and dark in photographs:
        fractions = list[tuple[str, ...]]()
        for power in POWERS:
            pair = (np.maximum(photographs[n], 0) ** (power / DECODING) for n in (lit, dark))
            fractions.append((f"{power:g}", *(f"{each:.3f}" for each in outside(*pair))))
        title = f"What {lit} has beside a multiple of {dark} outside range(B), over the latter."
        tables += [Table(title, ("power of the values", "red", "green", "blue"), fractions)]
    tables += [Table("Not read.", ("set", "why"), problems)] if problems else []
    return replace(section, claims=claims, tables=tables, pictures=[Picture(file, "All rooms.")])


def correlation(first: Array, second: Array) -> float:
    """Return the correlation of two arrays' values."""
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def outside(lit: Array, dark: Array) -> Array:
    """Return how much ambient light of a room lies outside range(B), over the room's own, (C,).

    White noise is blurred away. Ambient light is what the lit photograph has beside a multiple of
    the dark one; where their values are not linear, it holds products of both.
    """
    fit = _scene(dark.shape[:2]).method("noise-aware", noise=NOISE).fit
    y, y_dark = fit.project_out(
        np.concatenate([fit.planes(each[None])[0] for each in (lit, dark)])
    ).reshape(2, dark.shape[2], -1)
    multiples = np.sum(y * y_dark, axis=1) / np.sum(y_dark**2, axis=1)
    blurred = ndimage.gaussian_filter(lit / multiples - dark, (BLUR, BLUR, 0), mode="nearest")
    ambient = fit.project_out(fit.planes(blurred[None])[0])
    return np.asarray(np.linalg.norm(ambient, axis=1) / np.linalg.norm(y_dark, axis=1))


def _photographs() -> tuple[Mapping[str, Array], list[tuple[str, str]]]:
    """Return all photographs by name, and why sets cannot be had."""
    photographs, problems = dict[str, Array](), []
    for name, data in published_sets().items():
        if name.startswith(SETS):
            try:
                folder = ps.fetch(name)
                photographs |= {each: fields["photograph"] for each, fields in data.arrays(folder)}
            except ps.PeriscopyError as error:
                problems.append((name, str(error)))
    return photographs, problems


@cache
def _scene(film: tuple[int, int]) -> ps.Scenario:
    """Return the shipped scene at a camera's film."""
    return ps.load_scenario(SCENE, HIDDEN, {"film": film[0]})
