"""Which captures the published data set holds, and where its owners say that things stood.

What a placement gives differs from the shipped scene's own numbers, which are those of the set-up;
beside it stands what was written down, in metres: x from the left, z from the table top.

References
----------
C. Saunders, J. Murray-Bruce, V. K. Goyal, Nature 565 (2019): measurements beside the data, and the
published code's configuration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

CHAIR, AMBIENT, PLATE = "TestPosChair", "TestPosChairAmb", "TestPosD11"
VIDEO, VIDEO_MUSHROOM = "TestPosD11Video", "TestPosD11Video/Mush"
MUSHROOM_REPEATS, TOMMY_REPEATS = f"{CHAIR}/Mush", f"{CHAIR}/tommy"
SINGLE_PIXELS = f"{CHAIR}/Single Pixels"


@dataclass(frozen=True)
class Placement:
    """Where somebody says that occluder, monitor and field of view are.

    Attributes
    ----------
    source
        Who says so, and what.
    scene
        A scene's file, or a shipped one's name.
    parameters
        Values of its ``<default>``s.
    """

    source: str
    scene: str
    parameters: Mapping[str, float] = field(default_factory=dict)


def _numbered(prefix: str, numbers: range) -> tuple[str, ...]:
    return tuple(f"{prefix}{number}" for number in numbers)


_PICTURES = ("mushroom", "bur", "colbar", "smilehat")

STILLS: Mapping[str, Sequence[str]] = {
    CHAIR: tuple(f"image_test_{name}" for name in (*_PICTURES, "it0")),
    AMBIENT: ("image_test_it0",),
    PLATE: tuple(f"image_test{name}" for name in (
        *(f"_{name}" for name in _PICTURES), *(f"_{name}20" for name in _PICTURES), "",
    )),
}  # fmt: skip
"""Captures of one image each without ambient light, by folder."""

REPEATS: Mapping[str, Sequence[str]] = {
    MUSHROOM_REPEATS: _numbered("image_test_it", range(35)),
    TOMMY_REPEATS: _numbered("image_test_it", range(35)),
}
"""Captures of one and the same image, by folder."""

LEVELS: Sequence[tuple[str, str, str]] = (
    *((AMBIENT, f"image_test_mush{k}", f"image_test_amb{k}") for k in range(1, 6)),
    *((CHAIR, f"image_test_mush_ambient_{k}", f"image_test_ambient{k}") for k in (1, 2)),
)
"""Folder, the mushroom under ambient light, and this light alone."""

WITHOUT_AMBIENT: Mapping[str, str] = {AMBIENT: "image_test_mush0", CHAIR: "image_test_mushroom"}
"""The mushroom without ambient light, by folder of `LEVELS`."""

FRAMES: Mapping[str, Sequence[str]] = {
    VIDEO: _numbered("frame_", range(13)),
    VIDEO_MUSHROOM: _numbered("frame_", range(1, 8)),
}
"""Frames of videos in time's order, by folder."""

BLOCKS: Mapping[str, Sequence[str]] = {
    SINGLE_PIXELS: tuple(
        f"image_test_{row}_{side}" for row in ("bottom", "top") for side in ("left", "right")
    )
}
"""Captures of one lit block of the screen each."""


def captures() -> list[str]:
    """Return the names of all captures of the data set, with their folders, one after another."""
    by_folder = [STILLS, REPEATS, FRAMES, BLOCKS]
    names = [f"{folder}/{name}" for part in by_folder for folder in part for name in part[folder]]
    names += [f"{folder}/{name}" for folder, *pair in LEVELS for name in pair]
    names += [f"{AMBIENT}/{WITHOUT_AMBIENT[AMBIENT]}"]  # the chair's is one of its stills
    return sorted(names, key=lambda name: name.rpartition("/")[0])


# The field of view's sides are 0.401 for the shipped chair and 0.4372 for the shipped plate.
_RULER = Placement("the set-up: chair at x 0.506, 0.436 from the wall, z 0.242", "chair")
_LISTED = Placement(
    "also listed: x 0.503, 0.436 from the wall, z 0.244",
    "chair",
    {"occluder_dx": -0.003, "occluder_dz": 0.002},
)
_BESIDE_DATA = Placement(
    "written beside the data: x 0.501, 0.434 from the wall, z 0.242",
    "chair",
    {"occluder_dx": -0.005, "occluder_dy": 0.002},
)
_LATER = {"occluder_dx": -0.008, "occluder_dy": 0.021, "occluder_dz": 0.002}
_LATER_TEXT = "chair at x 0.498, 0.415 from the wall, z 0.244"
_NEARER_WALL = {"monitor_dy": 0.006}
_VIDEO_PLATE = {"occluder_dx": 0.002, "occluder_dy": -0.006, "occluder_dz": -0.004}
_VIDEO_TEXT = "plate at x 0.477, 0.466 from the wall, z 0.210"

PLACEMENTS: Mapping[str, Sequence[Placement]] = {
    CHAIR: (_RULER, _LISTED, _BESIDE_DATA),
    AMBIENT: (
        Placement(f"{_LATER_TEXT}, wall at 1.024", "chair", {**_LATER, **_NEARER_WALL}),
        Placement(
            "chair at x 0.506, 0.436 from the wall, z 0.242, wall at 1.024",
            "chair",
            _NEARER_WALL,
        ),
        _RULER,
    ),
    PLATE: (Placement("the set-up: plate at x 0.475, 0.460 from the wall, z 0.214", "plate"),),
    VIDEO: (
        Placement(
            f"{_VIDEO_TEXT}, view from (0.496, 0.014), side 0.4672",
            "plate",
            {
                **_VIDEO_PLATE,
                "camera_dx": -0.0100,
                "camera_dz": -0.0190,
                "camera_stretch": 0.4672 / 0.4372,
            },
        ),
    ),
    VIDEO_MUSHROOM: (
        Placement(
            f"{_VIDEO_TEXT}, view from (0.483, 0.021), side 0.468",
            "plate",
            {
                **_VIDEO_PLATE,
                "camera_dx": -0.0226,
                "camera_dz": -0.0116,
                "camera_stretch": 0.468 / 0.4372,
            },
        ),
    ),
}
"""Candidates by folder, the likeliest first; a subfolder without its own has its folder's."""


def place_of(folder: str) -> str:
    """Return the folder whose placements hold for captures of a folder."""
    return folder if folder in PLACEMENTS else folder.split("/")[0]
