"""Real ambient light: what of it the model holds, and what methods make of the mushroom under it.

The same light is photographed with the monitor showing the mushroom and with it dark. So the
signal-to-background ratio is measured, and the second photograph can serve as a background
photograph for the first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLUMN, PAGE, drawn, label_row, show_light
from experiments.published.data_set import Capture
from experiments.published.layout import LEVELS, WITHOUT_AMBIENT
from experiments.published.setting import PublishedSetting
from experiments.published.stills import psnrs
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import FittedScene
from periscopy_sim.figures.style import plain_ticks
from periscopy_sim.model.ambient import background_basis

Array = NDArray[np.float64]

OURS, OURS_WITH = "noise-aware", "noise-aware, background photograph"
PAPER, PAPER_WITH = "the paper's", "the paper's, background photograph"
NATURE, PUBLISHED = "[15], converged", "[15], as published"
LINES = {
    OURS: ("#009E73", "-"),
    OURS_WITH: ("#009E73", "--"),
    PAPER: ("#0072B2", "-"),
    PAPER_WITH: ("#0072B2", "--"),
    NATURE: ("#D55E00", "-"),
    PUBLISHED: ("#D55E00", ":"),
}
"""Colour and line of each method."""

LOWEST = (0.9, 1.2)
"""Ratios that the paper's lowest, 0.95, may be measured as."""

ACCEPTABLE = 1.2
"""Error over that without ambient light up to which degradation counts as minimal."""


@dataclass(frozen=True, eq=False)
class Level:
    """The mushroom under one level of ambient light.

    Attributes
    ----------
    lit, alone, dark
        The mushroom under ambient light, this light alone, and the mushroom without it; None where
        the capture cannot be read, and where there is no such light.
    images
        (R, C, 3) by method.
    refusal
        Why a background photograph does not serve; empty if it does.
    """

    lit: Capture
    alone: Capture | None
    dark: Capture | None
    images: Mapping[str, Array]
    refusal: str = ""

    @property
    def sbr(self) -> float | None:
        """Mean of the monitor's light over that of ambient light; None if this is not known."""
        if self.alone is None:
            return np.inf if self.lit is self.dark else None
        alone = self.alone.photograph.mean()
        return float((self.lit.photograph.mean() - alone) / alone)

    @property
    def truth(self) -> Array | None:
        """What the monitor showed; None if no file tells."""
        known = [c.truth for c in (self.lit, self.dark) if c is not None and c.truth is not None]
        return known[0] if known else None

    def error(self, method: str) -> float | None:
        """Return a method's mean squared error; None if the truth or the image is not known."""
        if self.truth is None or method not in self.images:
            return None
        return ps.mean_squared_error(self.images[method], self.truth)


def outside(Q: Array, first: Array, second: Array) -> Array:
    """Part of a background's norm outside the first k basis vectors, k = 0 to r, without its noise.

    From two pictures b₁, b₂ whose noise is independent: b₁ᵀ (I − Q_k Q_kᵀ) b₂ / b₁ᵀ b₂ is the
    squared part, on average over the noise. Its root is 0 where noise makes it negative.
    """
    b1, b2 = first.reshape(-1, 3), second.reshape(-1, 3)
    inside = np.cumsum(np.sum((Q.T @ b1) * (Q.T @ b2), axis=1)) / np.sum(b1 * b2)
    return np.asarray(np.sqrt(np.maximum(1 - np.concatenate([[0.0], inside]), 0)))


def run(setting: PublishedSetting) -> Section:
    """Measure the ambient light and reconstruct the mushroom under each level of it."""
    claims, pictures, tables, missing = [], [], [], []
    for folder, dark_name in WITHOUT_AMBIENT.items():
        pairs = [(lit, alone) for where, lit, alone in LEVELS if where == folder]
        names = [dark_name, *(name for pair in pairs for name in pair)]
        read = {
            capture.name.rpartition("/")[2]: capture for capture in setting.readable(folder, names)
        }
        missing += setting.not_read(folder, names)
        if not read:
            continue
        scene, dark = setting.fitted(folder), read.get(dark_name)
        lights = [read[alone] for _, alone in pairs if alone in read]
        if lights:
            tables.append(_light_table(folder, scene, lights))
        levels = []
        brightest = max(lights, key=lambda light: light.photograph.mean(), default=None)
        if dark is not None:
            levels.append(_level(scene, dark, None, dark, brightest))
        for name, alone_name in pairs:
            if name in read:
                alone = read.get(alone_name)
                levels.append(_level(scene, read[name], alone, dark, alone or brightest))
        if not levels:
            continue
        tables += [_level_table(folder, levels), _image_table(folder, levels)]
        claims += _claims(folder, levels)
        pictures += _draw(setting, folder, levels)
    return Section(
        "ambient",
        "Real ambient light",
        text="The mushroom under ambient light, and this light alone, by number: the fit of the "
        "first to a multiple of the mushroom without ambient light and one of the light alone says "
        "whether the numbers belong together (both near 1). The signal-to-background ratio is that "
        "of the means, from these photographs alone. A background photograph is the light alone; "
        "the mushroom without ambient light, too, is given one, of the brightest light, which "
        "shows the same wall's unevenness." + ("" if tables else " No capture of it can be read."),
        claims=claims,
        pictures=pictures,
        tables=[*tables, *missing],
    )


def _level(
    scene: FittedScene,
    lit: Capture,
    alone: Capture | None,
    dark: Capture | None,
    background: Capture | None,
) -> Level:
    """Reconstruct a level by every method, some of them with a background photograph, too."""

    def published() -> ps.Differencing:
        return ps.Differencing.for_scene(scene.scenario, scene.A, stop="published")

    fits: dict[str, Callable[[], ps.NoiseAware | ps.Periscope | ps.Differencing]] = {
        OURS: lambda: scene.noise_aware,
        PAPER: lambda: scene.preconditioned,
        NATURE: lambda: scene.differencing,
        PUBLISHED: published,
    }
    refusal = ""
    images = {name: fit().reconstruct(lit.photograph) for name, fit in fits.items()}
    if background is not None:
        given = (scene.scenario, scene.A, scene.B)
        for name, method in ((OURS_WITH, ps.NoiseAware), (PAPER_WITH, ps.Periscope)):
            try:
                off = [background.photograph]
                images[name] = method.for_scene(*given).reconstruct(
                    ps.Photograph.of(lit.photograph, monitor_off=off)
                )
            except (ValueError, ps.PeriscopyError) as error:
                refusal = str(error)
    return Level(lit, alone, dark, images, refusal)


def mixture(level: Level) -> tuple[Array, float] | None:
    """Fit a level's photograph by the mushroom without ambient light and that light alone.

    Returns
    -------
    (2,) ndarray
        Their factors.
    float
        What is left over the noise that the three photographs leave.
    """
    if level.alone is None or level.dark is None:
        return None
    parts = [level.dark, level.alone]
    X = np.stack([part.photograph.ravel() for part in parts], axis=1)
    y = level.lit.photograph.ravel()
    factors, *_ = np.linalg.lstsq(X, y, rcond=None)
    left = np.sqrt(np.mean((y - X @ factors) ** 2))
    variance = level.lit.noise**2 + sum(
        factor**2 * part.noise**2 for factor, part in zip(factors, parts, strict=True)
    )
    return factors, float(left / np.sqrt(variance.mean()))


def _light_table(folder: str, scene: FittedScene, lights: Sequence[Capture]) -> Table:
    Q = background_basis(scene.B)

    def left(values: Array) -> Array:
        y = values.reshape(-1, 3)
        return np.asarray(y - Q @ (Q.T @ y))

    energies = [float(np.vdot(left(c.halves[0]), left(c.halves[1]))) for c in lights]
    rows = []
    for k, capture in enumerate(lights):
        alike = [
            f"{np.vdot(left(capture.photograph), left(other.photograph)) / scale:.2f}"
            for j, other in enumerate(lights)
            if j != k and (scale := np.sqrt(max(energies[j], 0) * max(energies[k], 0))) > 0
        ]
        outer = outside(Q, capture.halves[0], capture.halves[1])[-1]
        norm = np.sqrt(np.mean(capture.photograph**2))
        rows.append(
            (
                capture.name.rpartition("/")[2],
                f"{capture.photograph.mean():.4g}",
                f"{100 * outer:.3f}",
                f"{100 * np.sqrt(np.mean(capture.noise**2)) / norm:.3f}",
                " ".join(alike),
            )
        )
    return Table(
        f"{folder}: ambient light alone. Counts for each unit of exposure; part of its norm "
        f"outside range(B) ({Q.shape[1]} dimensions kept) beyond noise, by two halves of the "
        "sensor; noise of a pixel; cosines, noise allowed for, of what is left outside with that "
        "of the others in order: near 1 where it is the wall (paint, dust, the lens), near 0 where "
        "it is the light.",
        ("capture", "counts", "outside range(B), %", "noise, %", "alike with the others"),
        rows,
    )


def _level_table(folder: str, levels: Sequence[Level]) -> Table:
    rows = []
    for level in levels:
        fit = mixture(level)
        by_dark = ""
        if level.alone is not None and level.dark is not None:
            by_dark = _ratio(level.dark.photograph.mean() / level.alone.photograph.mean())
        rows.append(
            (
                _short(level),
                _ratio(level.sbr),
                by_dark,
                "" if fit is None else f"{fit[0][0]:.4f}, {fit[0][1]:.4f}",
                "" if fit is None else f"{fit[1]:.2f}",
            )
        )
    return Table(
        f"{folder}: signal-to-background ratio, by this capture and the light alone, and by the "
        "mushroom without ambient light and the light alone; factors of these two that fit the "
        "photograph best; what they leave over what noise leaves.",
        ("capture", "SBR", "SBR by the dark room's", "factors", "left over noise"),
        rows,
    )


def _image_table(folder: str, levels: Sequence[Level]) -> Table:
    def cell(level: Level, method: str) -> str:
        if method not in level.images:
            return level.refusal if method in (OURS_WITH, PAPER_WITH) else ""
        if level.truth is None:
            return "no ground truth"
        return psnrs(level.images[method], level.truth)

    return Table(
        f"{folder}: PSNR in dB, gain-matched, unshifted and after the best shift of at most 2 "
        "patches.",
        ("capture", "SBR", *LINES),
        [
            (_short(level), _ratio(level.sbr), *(cell(level, method) for method in LINES))
            for level in levels
        ],
    )


def _claims(folder: str, levels: Sequence[Level]) -> list[Claim]:
    """Compare the lowest level down to 0.95 with the photograph without ambient light."""
    known = [level for level in levels if level.sbr is not None and level.truth is not None]
    bright = [level for level in known if level.sbr is not None and level.sbr > 4]
    dim = [level for level in known if level.sbr is not None and LOWEST[0] <= level.sbr < 4]
    if not bright or not dim:
        return []
    first = max(bright, key=lambda level: level.sbr or 0)
    lowest = min(dim, key=lambda level: level.sbr or 0)

    def loss(method: str, after: str = "") -> float:
        """Return a method's error over that in the dark, or of another method after it."""
        errors = first.error(method), lowest.error(after or method)
        assert errors[0] is not None and errors[1] is not None
        return errors[1] / max(errors[0], 1e-12)

    shown = f"{_ratio(first.sbr)} to SBR {_ratio(lowest.sbr)}"
    is_lowest = lowest.sbr is not None and LOWEST[0] <= lowest.sbr <= LOWEST[1]
    return [
        Claim(
            f"proposed: minimal degradation down to SBR 0.95 ({folder})",
            "minimal",
            f"error times {loss(PAPER):.2f}, {shown}",
            Verdict.of(loss(PAPER) < ACCEPTABLE) if is_lowest else Verdict.MEASURED,
            "" if is_lowest else "No capture of about that ratio can be read.",
        ),
        Claim(
            f"[15] struggles below SBR 4 ({folder})",
            "fails",
            f"error times {loss(PUBLISHED):.2f} as published, {loss(NATURE):.2f} converged, "
            f"{shown}",
            Verdict.of(min(loss(PUBLISHED), loss(NATURE)) > ACCEPTABLE),
        ),
        Claim(
            f"noise-aware method ({folder})",
            "",
            f"error times {loss(OURS):.2f}, with a background photograph "
            + (f"{loss(OURS, OURS_WITH):.2f}" if OURS_WITH in lowest.images else "not known")
            + f", {shown}",
            Verdict.MEASURED,
        ),
    ]


def _ratio(sbr: float | None) -> str:
    """Return a signal-to-background ratio as text."""
    if sbr is None:
        return "not known"
    return "no ambient light" if np.isinf(sbr) else f"{sbr:.2f}"


def _label(level: Level) -> str:
    """Return a level's capture and ratio, for beside a row of pictures."""
    ratio = _ratio(level.sbr)
    return f"{_short(level)}\n" + (
        ratio.replace(" ", "\n", 1) if ratio[0] == "n" else f"SBR {ratio}"
    )


def _short(level: Level) -> str:
    return level.lit.name.rpartition("/")[2].removeprefix("image_test_")


def _draw(setting: PublishedSetting, folder: str, levels: Sequence[Level]) -> list[Picture]:
    methods = [name for name in LINES if any(name in level.images for level in levels)]
    name = f"ambient_{folder}"
    with drawn(setting.out, name, PAGE, 0.95 * len(levels) + 0.4) as figure:
        axes = figure.subplots(len(levels), 1 + len(methods), squeeze=False)
        for row, level in zip(axes, levels, strict=True):
            show_light(row[0], level.lit.photograph)
            label_row(row[0], _label(level))
            for ax, method in zip(row[1:], methods, strict=True):
                ax.set_axis_off()
                if method in level.images:
                    image, truth = level.images[method], level.truth
                    matched = image if truth is None else ps.gain_matched(image, truth)
                    show_light(ax, matched, None if truth is None else 1)
        for ax, title in zip(axes[0], ("photograph", *methods), strict=True):
            ax.set_title(
                title.replace(", ", ",\n").replace("background ", "background\n"), fontsize=7
            )
    caption = (
        f"{folder}: photographs (white: the 99.5th percentile of each) and images, gain-matched "
        "where the ground truth is known."
    )
    return [Picture(setting.out / f"{name}.png", caption), *_draw_errors(setting, folder, levels)]


def _draw_errors(setting: PublishedSetting, folder: str, levels: Sequence[Level]) -> list[Picture]:
    measured = [level for level in levels if level.sbr is not None and 0 < level.sbr < np.inf]
    if len(measured) < 2 or any(level.truth is None for level in measured):
        return []
    name = f"ambient_errors_{folder}"
    with drawn(setting.out, name, COLUMN, 3.2) as figure:
        ax = figure.subplots()
        for method, (color, line) in LINES.items():
            points = sorted(
                (level.sbr, error)
                for level in measured
                if level.sbr is not None and (error := level.error(method)) is not None
            )
            if points:
                ax.plot(*zip(*points, strict=True), line, marker=".", color=color, label=method)
        ax.set(xscale="log", yscale="log", xlabel="SBR", ylabel="mean squared error")
        ax.set_xticks([level.sbr for level in measured], [_ratio(level.sbr) for level in measured])
        ax.minorticks_off()
        plain_ticks(ax.yaxis)
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center")
    return [Picture(setting.out / f"{name}.png", f"{folder}: error against the measured SBR.")]
