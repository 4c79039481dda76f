"""Scenes that calibrate themselves: from a start 5 cm off to where the photograph is explained.

The chair is moved by 5 cm in each direction from where the ruler found it, three times with other
signs, and `ps.calibrate` is to bring it back from the photograph alone: a rendered one under an
overcast sky at SBR 0.5, where the truth is known, and a real one where there is one. Calibration
knows nothing of the hidden image. The errors in the tables do, and the part of the photograph that
a scene explains given that image (one gain for each channel and the backgrounds B are free).

Of the real scene more is uncertain than where the chair stands: how it is turned, its sizes, where
the monitor is. What that may do to the values found is in their errors. The last row is what a user
does: all numbers that a ruler gave are free, as far as it errs, from where it has them.

`python -m experiments.beyond.calibration --out DIR [--real FILE.npz]`
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLORS, PAGE, drawn, show_light
from experiments.page import alone, described
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import SNR, Measured, Setting
from periscopy_sim.calibration.prior import Free, declared_errors
from periscopy_sim.calibration.result import Calibration
from periscopy_sim.reconstruction.background_subspace import background_basis

Array = NDArray[np.float64]
Images = dict[str, Array]

POSITION = ("occluder_dx", "occluder_dy", "occluder_dz")
OFF = 0.05
STARTS = ((1, 1, 1), (-1, 1, -1), (1, -1, 1))
RULER = (0, 0, 0)
LIGHT, SBR = "overcast", 0.5
ALL = "all that the ruler gave"
Tries = Sequence[tuple[str, Free | None, tuple[int, int, int]]]
BY_POSITION: Tries = [
    ("position", dict.fromkeys(POSITION, np.inf), signs)  # no ruler is 5 cm off
    for signs in STARTS
]


@dataclass(frozen=True, eq=False)
class Outcome:
    """One calibration and what it is worth."""

    what: str
    start: tuple[int, int, int]
    found: Calibration
    explained: float
    images: Images


def run(setting: Setting) -> Section:
    """Calibrate from every start."""
    rendered = ps.add_noise(
        ps.composite(setting.synthetic.signal, setting.backgrounds([LIGHT])[LIGHT], SBR),
        SNR,
        setting.seed,
    )
    subjects: dict[str, tuple[Measured, Array, Tries, dict[str, float]]] = {
        "rendered": (setting.synthetic, rendered, BY_POSITION, {})
    }
    if setting.measured.real:
        tries: Tries = [*BY_POSITION, (ALL, None, RULER)]
        errors = declared_errors(ps.find_scene("chair"), {})
        held = {name: error for name, error in errors.items() if name not in POSITION}
        subjects["real"] = (setting.measured, setting.measured.signal, tries, held)
    outcomes: dict[str, list[Outcome]] = {}
    nominal: dict[str, tuple[float, Images]] = {}
    for kind, (measured, photograph, trials, uncertain) in subjects.items():
        nominal[kind] = _worth(setting, measured, photograph, {})
        outcomes[kind] = []
        for what, free, signs in trials:
            start = dict(zip(POSITION, OFF * np.array(signs), strict=True))
            found = ps.calibrate(
                photograph,
                "chair",
                setting.hidden,
                free,
                parameters=start,
                uncertain=uncertain if free else {},
                mask=_inside(photograph),
                seed=setting.seed,
            )
            explained, images = _worth(setting, measured, photograph, found.values)
            ends = ", ".join(f"{p.name} {p.value:.5g}" for p in found.parameters)
            print(f"{kind}, {what} from {signs}: {ends}", file=sys.stderr, flush=True)
            outcomes[kind].append(Outcome(what, signs, found, explained, images))
    for kind, (measured, *_) in subjects.items():
        _draw(setting, kind, measured, nominal[kind][1], outcomes[kind])
    return Section(
        name="calibration",
        title="Scenes that calibrate themselves",
        text=described(__doc__),
        claims=[_claim(kind, outcomes[kind]) for kind in subjects],
        pictures=[
            Picture(
                setting.out / f"calibration_{kind}.png",
                f"The {kind} photograph. Above: the chair's place at the points that were the best "
                "so far, coarse to fine, from each start. Below: the hidden image and its "
                "reconstructions, gain-matched, shifted by at most 2 patches; the last is that of "
                f"the table's last row ({outcomes[kind][-1].what}).",
            )
            for kind in subjects
        ],
        tables=[
            _table(kind, measured, nominal[kind], outcomes[kind])
            for kind, (measured, *_) in subjects.items()
        ],
    )


def _inside(photograph: Array) -> NDArray[np.bool_]:
    """Return the mask that leaves out a bad border, as the commands do unasked."""
    return ps.bad_border(photograph).inside(photograph.shape[:2])


def _worth(
    setting: Setting, measured: Measured, photograph: Array, values: Mapping[str, float]
) -> tuple[float, Images]:
    """Reconstruct with the scene at some values, and tell how it explains the photograph."""
    scene = ps.load_scenario("chair", setting.hidden, dict(values))
    A, B = ps.render_transport(scene), ps.point_light_backgrounds(scene)
    images = {
        name: np.asarray(
            method.for_scene(scene, A, B, mask=_inside(photograph)).reconstruct(photograph),
            np.float64,
        )
        for name, method in (("preconditioned", ps.Periscope), ("noise-aware", ps.NoiseAware))
    }
    Q = background_basis(B)
    y = photograph.reshape(-1, 3)
    shadows = A @ measured.truth.reshape(-1, 3)
    rest, shadows = (image - Q @ (Q.T @ image) for image in (y, shadows))
    gains = np.sum(rest * shadows, axis=0) / np.sum(shadows**2, axis=0)
    return float(np.linalg.norm(rest - gains * shadows) / np.linalg.norm(y)), images


def _claim(kind: str, outcomes: Sequence[Outcome]) -> Claim:
    found = [o.found for o in outcomes if o.what == "position"]
    off = np.array([[abs(p.value) for p in f.parameters] for f in found])
    errors = np.array([[p.standard_error for p in f.parameters] for f in found])
    place = "its place" if kind == "rendered" else "the ruler's place"

    def listed(values: Array) -> str:
        return ", ".join(f"{value:.2g}" for value in values)

    return Claim(
        f"{kind} photograph: distance of the chair from {place}, worst of {len(off)} starts, mm in "
        "x, y, z",
        "",
        f"{listed(1e3 * off.max(axis=0))} ({listed((off / errors).max(axis=0))} standard errors); "
        f"{sum(f.trusted for f in found)} of {len(found)} trusted",
        Verdict.MEASURED,
    )


def _table(
    kind: str, measured: Measured, nominal: tuple[float, Images], outcomes: Sequence[Outcome]
) -> Table:
    def quality(explained: float, images: Images) -> list[str]:
        cells = [f"{100 * explained:.2f}"]
        for image in images.values():
            best = ps.registered(image, measured.truth)
            cells.append(f"{ps.psnr(image, measured.truth):.2f} / {best.psnr:.2f}")
        return cells

    def told(outcome: Outcome) -> str:
        if outcome.what == ALL:
            return "; ".join(
                f"{p.name} {p.value:.3g} ± {p.standard_error:.1g}"
                for p in outcome.found.parameters
                if p.determined or abs(p.value - p.start) > 2 * p.ruler_error
            )
        return "; ".join(
            f"{1e3 * p.value:.2f} ± {1e3 * p.standard_error:.2f} ({1e3 * p.statistical_error:.2f})"
            for p in outcome.found.parameters
        )

    def signed(start: tuple[int, int, int]) -> str:
        if start == RULER:
            return "the ruler's"
        return ", ".join(f"{5 * sign:+d}" for sign in start)

    rows = [("none", "the ruler's", "", "", *quality(*nominal), "")]
    for outcome in outcomes:
        left = 100 * float(np.sqrt(np.mean(outcome.found.noise**2)))
        row = (outcome.what, signed(outcome.start), told(outcome), f"{left:.2f}")
        trusted = "yes" if outcome.found.trusted else "no"
        rows.append((*row, *quality(outcome.explained, outcome.images), trusted))
    return Table(
        f"The {kind} photograph. Place in mm, ± standard errors (in parentheses: if all else in "
        "the scene were right); of all that the ruler gave those that the photograph determines "
        "or moves by more than two of its errors; unexplained: of the photograph by any image, and "
        "given the hidden image; PSNR as it stands and after the best shift.",
        (
            "free",
            "start, cm",
            "found",
            "unexplained, %",
            "given the image, %",
            "the paper's method, dB",
            "noise-aware, dB",
            "trusted",
        ),
        rows,
    )


def _draw(
    setting: Setting,
    kind: str,
    measured: Measured,
    nominal: Images,
    outcomes: Sequence[Outcome],
) -> None:
    shown = outcomes[-1]
    with drawn(setting.out, f"calibration_{kind}", PAGE, 4.2) as figure:
        above, below = figure.subfigures(2, 1, height_ratios=[2.3, 1.9])
        _draw_ways(above, [o for o in outcomes if o.what == "position"])
        pictures = [
            ("hidden image", measured.truth, None),
            ("the paper's,\nby the ruler", nominal["preconditioned"], measured.truth),
            ("noise-aware,\nby the ruler", nominal["noise-aware"], measured.truth),
            ("noise-aware,\ncalibrated", shown.images["noise-aware"], measured.truth),
        ]
        for ax, (title, image, truth) in zip(below.subplots(1, 4), pictures, strict=True):
            if truth is None:
                show_light(ax, image, 1)
            else:
                best = ps.registered(image, truth)
                show_light(ax, best.image, 1)
                title = f"{title}\n{best.psnr:.1f} dB"
            ax.set_title(title)


def _draw_ways(figure: object, outcomes: Sequence[Outcome]) -> None:
    """Each coordinate of the chair at the points that were the best so far, level by level."""
    colours = (COLORS["preconditioned"], COLORS["differencing"], COLORS["pseudoinverse"])
    axes = figure.subplots(1, 3, sharey=True)  # type: ignore[attr-defined]
    for k, (ax, name) in enumerate(zip(axes, POSITION, strict=True)):
        for outcome, colour in zip(outcomes, colours, strict=False):
            for level, visited in enumerate(outcome.found.path):
                best = np.minimum.accumulate(visited.evidence)
                order = np.flatnonzero(visited.evidence == best)
                place = level + (order + 0.5) / len(best)
                ax.plot(place, 1e2 * visited.values[order, k], ".-", color=colour, markersize=3)
        ax.axhline(0, color="black", linewidth=0.6, linestyle=":")
        ax.set_title(name)
        shapes = [visited.photograph_shape for visited in outcomes[0].found.path]
        middles = np.arange(len(shapes)) + 0.5
        ax.set_xticks(middles, [f"{rows} x {columns}" for rows, columns in shapes])
        ax.set_xlabel("pixels of the level")
    axes[0].set_ylabel("from the ruler's place, cm")


if __name__ == "__main__":
    alone(run)
