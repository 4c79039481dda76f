"""The sentences for people: notes and warnings arrive as codes with values."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Note, Report

SENTENCES = {
    "no_hidden_image": (
        "the photograph hardly shows a hidden image; check that the monitor was on, and the scene"
    ),
    "ambient_lines": "lines of ambient light cross the wall; the image is without their light",
    "wall_gain": "the image allows for a gain over the wall of {low:.2f} to {high:.2f}",
    "place": (
        "If the scene's numbers err as declared, the image may sit ± {most:.1f} patches from its "
        "place; the photograph cannot show this."
    ),
    "exposure_of": (
        "the exposure of {camera} is {exposure:.4g} ± {error:.2g} times that of {first}"
    ),
    "exposure": (
        "the views hardly show the same parts of the hidden scene: the exposure of {camera} is "
        "known to {percent:.2g} %, and so is the brightness of what it alone shows"
    ),
    "fits": "The scene fits: {unexplained:.3g} % unexplained, {noise_alone:.3g} % noise.",
    "nearly_fits": (
        "The scene nearly fits: {unexplained:.3g} % unexplained, {noise_alone:.3g} % noise."
    ),
    "image_does_not_fit": (
        "The scene fits, this image does not: {unexplained:.3g} % unexplained, {noise_alone:.3g} % "
        "noise."
    ),
    "does_not_fit": (
        "The scene does not fit: {unexplained_by_any:.3g} % unexplained, {noise_alone:.3g} % noise."
    ),
    "unexplained": (
        "The image is unreliable: {unexplained:.3g} % unexplained, {noise_alone:.3g} % noise."
    ),
    "not_judged": (
        "This method judges no scene: {unexplained:.3g} % unexplained, {noise_alone:.3g} % noise."
    ),
    "no_residual": "This method judges no scene: it does not use A.",
    "patches": "Take more patches (--hidden).",
    "numbers": "Run calibrate.",
    "look": "Look at residual.png.",
    "better_transport": "Pass {options}.",
    "paint": "Pass --monitor-off.",
    "measure": "Measure {names} again.",
    "distrusted_scene": "Its calibration is not trusted.",
    "shadows": "{scene}: {doubt}",
    "default_method": "Try the default method.",
    "defects": "{name}: excluded pixels that do not measure the wall ({defects})",
    "trusted": "The calibration is trusted: {after} % unexplained, {before} % before.",
    "kept": "No significant improvement; the measured values are kept.",
    "rival": "The calibration is trusted, but the image may lie elsewhere ({count} other scenes).",
    "distrusted": "Do not trust this {what}.",
    "silhouette": "The silhouette is trusted: {with_it} % unexplained, {without} % without it.",
    "rivals": ("the image may lie elsewhere: {scenes}; compare the images in {picture}"),
    "any_place": (
        "the numbers and the image may be displaced together by whole patches: only a known "
        "picture (--shown) fixes the place"
    ),
    "assumed_colours": (
        "the colour matrix rests in part on published ones; show a picture of many colours (blocks)"
    ),
    "no_derivatives": "{scene} has no closed form: the standard errors ignore its declared errors",
    "transport_error": (
        "{name} by {model} errs by {error:.3g} % of the light, more than a third of the noise of "
        "{noise:.3g} %"
    ),
    "bounces": (
        "{scene}: light that bounces off other surfaces is {ratio:.2g} times the noise: pass "
        "--bounces all"
    ),
    "fine_grid": (
        "{patches:,} patches: {method} needs about {memory:.1f} GB of memory; after A, "
        "the fit takes {seconds:.0f} s or more on two cores, and the standard errors as long"
    ),
    "hardly_seen": "the photograph hardly shows {name}: {percent:.2g} % of the light, if white",
    "glossy": "{scene}: {names} ({materials}) counts as diffuse, and the image may be wrong",
    "reflecting": "{names}: no emitter, so the image is radiance, not albedo.",
    "other_lights": (
        "{scene}: the light of {names} counts as ambient; to recover it, begin its shape's id with "
        "'hidden'"
    ),
    "no_record": "{file} has no JSON file beside it: it may be of another scene",
    "uncounted": (
        "{scene}: {names} changed since the calibration, so its errors do not count; reconstruct "
        "--uncertain NAME=ERROR states others"
    ),
    "no_best": "no point is best: no scene determines all patches; choose fewer (--hidden)",
    "empty_splits": "no geometry is for {splits}: make more samples, or lower samples_per_geometry",
}
"""By the code of a `Note`, or the code that a command gives."""


BETTER_TRANSPORT = {
    "file": "a --transport of more rays",
    "size": "a --hidden of more patches, or a film of more pixels",
    "areas": "--model analytic",
    "rays": "--samples {more_rays}",
}
"""Options that lower the error of A, by the remedy of a note on it."""


def sentence(code: str, **values: Any) -> str:
    """Return the sentence of a code."""
    return SENTENCES[code].format(**values)


def note_sentence(note: "Note") -> str:
    """Return the sentence of a note, with the options that help if there are any."""
    values = dict(note.values)
    options = BETTER_TRANSPORT.get(values.get("remedy", ""), "").format(**values)
    if note.code == "distrusted_scene":
        return distrusted(note.code, note.values["names"])
    line = sentence(note.code, options=options, **values)
    return f"{line}: pass {options}" if options and note.code == "transport_error" else line


def report_sentences(report: "Report") -> list[str]:
    """Return the sentences of a report: its verdict, if it has one, warnings and notes."""
    notes = [*report.warnings, *report.notes]
    if report.verdict.code == "fits":  # others are among the warnings
        notes.insert(0, report.verdict)
    return [*map(note_sentence, notes)]


def colour(report: "Report") -> str:
    """Return the colour of a report's verdict: green where the scene fits, yellow if in doubt."""
    if any(note.code == "distrusted_scene" for note in report.remedies):
        return "red"
    return {"fits": "green", "does_not_fit": "red", "unexplained": "red"}.get(
        report.verdict.code, "yellow"
    )


def distrusted(code: str, names: Sequence[str], **values: str) -> str:
    """Return the sentence that a result is not trusted, and which numbers to measure again."""
    again = sentence("measure", names=", ".join(names)) if names else ""
    return f"{sentence(code, **values)} {again}".rstrip()


def verdict(report: "Report", *, with_remedies: bool = False) -> str:
    """Return one line: whether the scene fits, what is unexplained beside noise, and remedies."""
    notes = report.verdict, *(report.remedies if with_remedies else ())
    return " ".join(map(note_sentence, notes))


def assumptions(uncertain: Iterable[str]) -> str:
    """Return what standard errors assume, but for the uncertain parameters that they count."""
    counted = list(uncertain)
    names = f"its {len(counted)} uncertain numbers" if counted[3:] else ", ".join(counted)
    scene = f"the scene is right but for {names}" if counted else "the scene is right"
    return f"{scene}, and that unseen details vary like seen ones"


def comparison(compared: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Return rows of metrics against the truth, a value for each surface."""
    surfaces = compared.values()
    return [
        ["PSNR against the truth", *(f"{each['psnr']:.2f} dB" for each in surfaces)],
        ["after the best shift", *(f"{each['psnr_registered']:.2f} dB" for each in surfaces)],
        ["best shift", *map(_shift, surfaces)],
        ["after the best colours", *(f"{each['psnr_colour_matched']:.2f} dB" for each in surfaces)],
    ]


def _shift(compared: Mapping[str, Any]) -> str:
    """Return the best shift in words."""
    limit = ", at the limit of the search" if compared["shift_at_limit"] else ""
    ways = zip(compared["shift"], (("down", "up"), ("right", "left")), strict=True)
    moves = [
        f"{abs(n):g} {'patch' if abs(n) <= 1 else 'patches'} {to[n < 0]}" for n, to in ways if n
    ]
    return f"{', '.join(moves) or 'none'}{limit}"
