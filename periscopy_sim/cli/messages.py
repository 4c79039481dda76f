"""The sentences for people: notes and warnings arrive as codes with values."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from periscopy_sim.model.residual import Residual
    from periscopy_sim.reconstruction.method import Note, Report

SENTENCES = {
    "no_hidden_image": (
        "the photograph hardly shows a hidden image: its light is no more than noise; check that "
        "the monitor was on and that the scene is the photograph's"
    ),
    "wall_gain": (
        "the monitor's light over the wall is {low:.2f} to {high:.2f} times the scene's; the image "
        "allows for this smooth gain"
    ),
    "place": (
        "errors of the scene displace the image by {down:.1f} patches down and {across:.1f} across "
        "(one standard error), which no photograph of an unknown image shows"
    ),
    "does_not_fit": (
        "the scene does not fit: any hidden image leaves {unexplained_by_any:.3g} % of the "
        "photograph unexplained, noise alone {noise_alone:.3g} %. Measure or calibrate the "
        "scene (periscopy calibrate), mask what is not bare wall (--mask), add a photograph with "
        "the monitor off (--monitor-off), export linear values, give as many patches as the "
        "picture has (--hidden), or, where rays render A, take more of them (--samples 256)"
    ),
    "unexplained": (
        "the image leaves {unexplained:.3g} % of the photograph unexplained, far more than noise: "
        "it is unreliable. Check the scene, its backgrounds (--light-model, --monitor-off) and the "
        "photograph's values, or try another method"
    ),
    "defects": "{name}: left out pixels that do not measure the wall ({defects})",
    "any_place": (
        "the numbers and the image may be displaced together by whole patches: only a known "
        "picture (--shown) fixes the place"
    ),
    "no_derivatives": (
        "{scene} has no closed form: the standard errors do not count the errors that it declares"
    ),
    "no_record": "{file} has no JSON file beside it: it may be of another scene",
    "uncounted": (
        "{scene}: the standard errors ignore the calibration's ({names} changed since); pass "
        "--uncertain"
    ),
    "untrusted": (
        "{scene}: its calibration is unreliable, and so are the image's place and its standard "
        "errors"
    ),
    "no_best": "no point is best: no scene determines all patches; choose fewer (--hidden)",
    "empty_splits": (
        "no geometry is for {splits}: make more samples, or choose a smaller samples_per_geometry"
    ),
}
"""By the code of a `Note`, or the code that a command gives."""


def sentence(code: str, **values: Any) -> str:
    """Return the sentence of a code."""
    return SENTENCES[code].format(**values)


def sentences(notes: "Iterable[Note]") -> list[str]:
    """Return the sentence of each note."""
    return [sentence(note.code, **note.values) for note in notes]


def report_sentences(report: "Report") -> list[str]:
    """Return the sentences of a report, warnings first."""
    return sentences([*report.warnings, *report.notes])


def residual_summary(residual: "Residual") -> str:
    """Return how much of a photograph is unexplained, and how much noise alone would leave."""
    from periscopy_sim.model.residual import percentages

    unexplained, alone = percentages(residual.unexplained, residual.noise_alone or 0.0, 4)
    summary = f"unexplained: {unexplained} % of the photograph"
    if residual.noise_alone is None:
        return summary
    if residual.diagnosis == "unknown":
        return f"{summary} by this image, no least-squares fit; it does not judge the scene"
    return f"{summary}; noise alone would leave {alone} %"


def matrix_remedy(entry: str, recorded: Any) -> str:
    """Return what makes a command fit the matrix in a file, by an entry of the file's record."""
    match entry, recorded:
        case "bounces", str():
            return f"pass --bounces {recorded}"
        case "hidden_shape", [rows, columns]:
            return f"pass --hidden {rows}x{columns}"
        case "parameters", dict():
            given = " ".join(f"-D {name}={value}" for name, value in recorded.items())
            return f"pass {given} alone" if given else "leave out -D"
    return "render the matrix again"


def assumptions(uncertain: Iterable[str]) -> str:
    """Return what standard errors assume, but for the uncertain parameters that they count."""
    counted = list(uncertain)
    names = f"its {len(counted)} uncertain numbers" if counted[3:] else ", ".join(counted)
    scene = f"the scene is right but for {names}" if counted else "the scene is right"
    return f"{scene}, and that unseen details vary like seen ones"


def comparison(compared: Mapping[str, Any]) -> str:
    """Return metrics against the truth."""
    limit = ", at the limit of the search" if compared["shift_at_limit"] else ""
    ways = zip(compared["shift"], (("down", "up"), ("to the right", "to the left")), strict=True)
    moves = [
        f"{abs(n):g} {'patch' if abs(n) <= 1 else 'patches'} {to[n < 0]}" for n, to in ways if n
    ]
    return (
        f"against the truth: PSNR {compared['psnr']:.2f} dB, {compared['psnr_registered']:.2f} dB "
        f"after the best shift ({', '.join(moves) or 'none'}{limit}), "
        f"{compared['psnr_colour_matched']:.2f} dB after the matrix of colours that fits it best"
    )
