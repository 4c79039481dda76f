"""Real ambient light: what of it the model holds, and what methods make of the mushroom under it.

The same light is photographed with the monitor showing the mushroom and with it dark. So the
signal-to-background ratio is measured, and the second photograph can serve as a background
photograph for the first.
"""

import numpy as np

import periscopy_sim as ps
from experiments.paper.as_published import Published
from experiments.published.recovered import NATURE, OURS, PAPER, Recovered, picture, table
from experiments.published.setting import AMBIENT, CHAIR, Capture, PublishedSetting
from experiments.report import Claim, Section, Table, Verdict
from experiments.setting import FittedScene
from periscopy_sim.model.transport_operator import background_basis
from periscopy_sim.numerics import Array

LEVELS = {
    AMBIENT: {f"mush{k}": f"amb{k}" for k in range(1, 6)},
    CHAIR: {f"mush_ambient_{k}": f"ambient{k}" for k in (1, 2)},
}
"""The mushroom under ambient light, and this light alone, by set."""

WITHOUT_AMBIENT = {AMBIENT: "mush0", CHAIR: "mushroom"}
"""The mushroom without ambient light."""

OURS_WITH, PAPER_WITH = (f"{method}, monitor off" for method in (OURS, PAPER))
PUBLISHED = "[15], as published"

LOWEST = (0.9, 1.2)
"""Ratios that the paper's lowest, 0.95, may be measured as."""

ACCEPTABLE = 1.2
"""Error over that without ambient light up to which degradation counts as minimal."""


def run(setting: PublishedSetting) -> Section:
    """Measure the ambient light and reconstruct the mushroom under each level of it."""
    claims, pictures, tables = list[Claim](), [], []
    for name, pairs in LEVELS.items():
        read = {capture.name: capture for capture in setting.captures(name)}
        dark, scene = read.get(WITHOUT_AMBIENT[name]), setting.fitted(name)
        lights = {alone: read[alone] for alone in pairs.values() if alone in read}
        if dark is None or not lights:
            continue
        brightest = max(lights.values(), key=lambda light: light.photograph.mean())
        levels = {np.inf: _recovered(scene, dark, dark, brightest, np.inf)}
        for lit, alone in pairs.items():
            if lit in read and alone in read:
                total, level = (read[each].photograph.mean() for each in (lit, alone))
                sbr = float((total - level) / level)
                levels[sbr] = _recovered(scene, read[lit], dark, read[alone], sbr)
        tables += [_light_table(name, scene, lights), table(name, [*levels.values()])]
        pictures.append(picture(setting.out, f"ambient light of {name}", [*levels.values()]))
        claims += _claims(name, levels)
    return Section(
        "ambient",
        "Real ambient light",
        text="The mushroom under ambient light, and this light alone, by number. The "
        "signal-to-background ratio is that of the means, from these photographs alone. A "
        "background photograph is the light alone; the mushroom without ambient light, too, is "
        "given one, of the brightest light, which shows the same wall's unevenness."
        if tables
        else "No capture of it can be read.",
        claims=claims,
        pictures=pictures,
        tables=[*tables, *setting.not_read(*LEVELS)],
    )


def _recovered(
    scene: FittedScene, lit: Capture, dark: Capture, background: Capture, sbr: float
) -> Recovered:
    """Reconstruct by every method, two of them with a background photograph, too."""
    alone = ps.Photograph.of(lit.photograph)
    whole = ps.Photograph.of(lit.photograph, monitor_off=[background.photograph])
    asked = {
        OURS: ("noise-aware", alone),
        OURS_WITH: ("noise-aware", whole),
        PAPER: ("preconditioned", alone),
        PAPER_WITH: ("preconditioned", whole),
        NATURE: ("differencing", alone),
        PUBLISHED: (Published, alone),
    }
    images = {
        title: scene.method(name, each).reconstruct(each) for title, (name, each) in asked.items()
    }
    truth = dark.truth if lit.truth is None else lit.truth
    return Recovered(lit, truth, images, {"SBR": _ratio(sbr)})


def outside(Q: Array, first: Array, second: Array) -> Array:
    """Part of a background's norm outside the first k basis vectors, k = 0 to r, without its noise.

    From two pictures b₁, b₂ whose noise is independent: b₁ᵀ (I − Q_k Q_kᵀ) b₂ / b₁ᵀ b₂ is the
    squared part, on average over the noise. Its root is 0 where noise makes it negative.
    """
    b1, b2 = first.reshape(-1, 3), second.reshape(-1, 3)
    inside = np.cumsum(np.sum((Q.T @ b1) * (Q.T @ b2), axis=1)) / np.sum(b1 * b2)
    return np.asarray(np.sqrt(np.maximum(1 - np.concatenate([[0.0], inside]), 0)))


def _light_table(name: str, scene: FittedScene, lights: dict[str, Capture]) -> Table:
    Q = background_basis(scene.B)

    def rest(values: Array) -> Array:
        y = values.reshape(-1, 3)
        return np.asarray(y - Q @ (Q.T @ y))

    def product(first: Capture, second: Capture) -> float:
        """Return the product of what two leave; of one with itself, that of its halves."""
        pair = first.halves if first is second else (first.photograph, second.photograph)
        return float(np.vdot(rest(pair[0]), rest(pair[1])))

    def alike(first: Capture, second: Capture) -> float:
        energies = product(first, first), product(second, second)
        return product(first, second) / np.sqrt(np.prod(np.maximum(energies, 1e-300)))

    def others(own: str) -> str:
        alikes = (alike(lights[own], each) for name, each in lights.items() if name != own)
        return " ".join(f"{each:.2f}" for each in alikes)

    return Table(
        f"{name}: ambient light alone. Counts for each unit of exposure; part of its norm "
        f"outside range(B) ({Q.shape[1]} dimensions kept) beyond noise, by two halves of the "
        "sensor; cosines, noise allowed for, of what is left outside with that of the others in "
        "order: near 1 where it is the wall (paint, dust, the lens), near 0 where it is the light.",
        ("capture", "counts", "outside range(B), %", "alike with the others"),
        [
            (
                own,
                f"{capture.photograph.mean():.4g}",
                f"{100 * outside(Q, *capture.halves)[-1]:.3f}",
                others(own),
            )
            for own, capture in lights.items()
        ],
    )


def _claims(name: str, levels: dict[float, Recovered]) -> list[Claim]:
    """Compare the lowest level down to 0.95 with the photograph without ambient light."""
    first, sbr = levels[np.inf], min((s for s in levels if s >= LOWEST[0]), default=np.inf)
    lowest = levels[sbr]
    if lowest.truth is None or first.truth is None or sbr > LOWEST[1]:
        return []

    def loss(method: str, after: str = "") -> float:
        """Return a method's error over that in the dark, or of another method after it."""
        dark = ps.mean_squared_error(first.images[method], first.truth)
        return float(ps.mean_squared_error(lowest.images[after or method], lowest.truth) / dark)

    shown = f"no ambient light to SBR {sbr:.2f}"
    published, converged = loss(PUBLISHED), loss(NATURE)
    return [
        Claim(
            f"proposed: minimal degradation down to SBR 0.95 ({name})",
            "minimal",
            f"error times {loss(PAPER):.2f}, {shown}",
            Verdict.of(loss(PAPER) < ACCEPTABLE),
        ),
        Claim(
            f"[15] struggles below SBR 4 ({name})",
            "fails",
            f"error times {published:.2f} as published, {converged:.2f} converged, {shown}",
            Verdict.of(min(published, converged) > ACCEPTABLE),
        ),
        Claim(
            f"noise-aware method ({name})",
            "",
            f"error times {loss(OURS):.2f}, with a background photograph "
            f"{loss(OURS, OURS_WITH):.2f}, {shown}",
            Verdict.MEASURED,
        ),
    ]


def _ratio(sbr: float) -> str:
    """Return a signal-to-background ratio as text."""
    return "no ambient light" if np.isinf(sbr) else f"{sbr:.2f}"
