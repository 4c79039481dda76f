"""Where things stood: what each stated placement leaves unexplained of a capture."""

from __future__ import annotations

from experiments.published.layout import PLACEMENTS
from experiments.published.setting import PublishedSetting
from experiments.report import Section, Table


def run(setting: PublishedSetting) -> Section:
    """Try every placement on one capture of its folder."""
    rows = []
    for folder in PLACEMENTS:
        capture = setting.reference(folder)
        if capture is None:
            rows.append((folder, "", "no capture without ambient light can be read", "", ""))
            continue
        noise = 100 * (capture.noise**2).mean() ** 0.5 / (capture.photograph**2).mean() ** 0.5
        for number, tried in enumerate(setting.tried(folder)):
            assert tried.unexplained is not None
            name = folder if number == 0 else ""
            rows.append(
                (
                    name,
                    capture.name.rpartition("/")[2] if number == 0 else "",
                    f"{tried.placement.source} ({tried.placement.scene})",
                    f"{100 * tried.unexplained:.3f}",
                    f"{noise:.3f}" if number == 0 else "",
                )
            )
    return Section(
        "placements",
        "Where things stood",
        text="The owners of the data wrote down more than one place for some folders. Each is "
        "tried on one capture; what scene and image leave unexplained of it decides, without the "
        "ground truth, and the rest of the page uses the first of each folder. Where much more "
        "than the noise is left, the scene is off: periscopy calibrate finds a better one, and "
        "--scene FOLDER=SCENE uses it here.",
        tables=[
            Table(
                "Unexplained by scene and noise-aware image, and noise, both in % of the "
                "photograph's root mean square.",
                ("folder", "capture", "placement", "unexplained", "noise"),
                rows,
            )
        ],
    )
