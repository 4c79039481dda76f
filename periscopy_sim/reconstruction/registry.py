"""The methods by name: a description, the options, and the class for videos of each.

A new method is one file with its class, a `StillMethod`, and one entry in `METHODS`. The command
line, the sweeps and their help follow from the entry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

from periscopy_sim.numerics.validation import RANGES, checked_number

if TYPE_CHECKING:
    from periscopy_sim.model.uncertainty import UncertainTransport
    from periscopy_sim.numerics import Image
    from periscopy_sim.reconstruction.method import FrameByFrame, StillMethod


@dataclass(frozen=True)
class Option:
    """A number that a method can be given, between two bounds."""

    name: str  # for users, on the command line and in summaries
    default: float  # the class's
    help: str  # what it does
    least: float = 0.0
    most: float = 1e9
    unit: str = ""  # what it counts in with this method, and what 0 does, where that needs saying
    parameter: str = ""  # of the class; empty if it has the option's name
    coupling: str = ""  # of a video's frames, that it belongs to; empty if it is of none
    whole: bool = False  # whether it counts

    def checked(self, value: Any, name: str = "") -> float:
        """Return a value, whole where the option counts; an InputError if it is out of range."""
        return checked_number(value, name or self.name, self.least, self.most, whole=self.whole)


@dataclass(frozen=True)
class VideoEntry:
    """How a method recovers videos.

    Its class is a `FrameByFrame` that accepts the method for stills and the keyword ``coupling``.
    """

    of: str  # ``module:class`` within `periscopy_sim.reconstruction`
    couplings: tuple[str, ...]  # how a frame can be tied to the one before it
    options: tuple[Option, ...] = ()  # further keywords of the class


@dataclass(frozen=True)
class MethodEntry:
    """A method of the package; called, it is fitted to a scene.

    Its class is a `StillMethod`, imported when used.
    """

    name: str  # for users
    help: str  # what it is, in a few words
    of: str  # ``module:class`` within `periscopy_sim.reconstruction`
    options: tuple[Option, ...] = ()  # what users can set
    certainty: str = ""  # the certainty that it reports, in a few words; empty for none
    backgrounds: bool = True  # whether it accepts the prototype backgrounds
    uncertain: bool = False  # whether it knows what to do with an uncertain scene
    rays: bool = False  # whether it wants random rays' noise in A: a ridge for P, 1 to 2 dB
    video: VideoEntry | None = None  # None if it recovers no videos
    views: str = ""  # the class for several views, as `of`; empty if it takes one view alone
    bytes_per_entry: int = 33  # of A, while it is fitted: A and B themselves, and copies (measured)
    patterns: bool = False  # whether `spectral_basis.cost` comes on top

    def __call__(
        self,
        scene: Any,
        A: Image,
        B: Image,
        uncertain: UncertainTransport | None = None,
        **options: float,
    ) -> StillMethod[Any]:
        """Return the method for a scene, as `StillMethod.for_scene`; the options by their names.

        Only methods that know uncertain scenes accept one.
        """
        fitted: StillMethod[Any] = _class(self.of).for_scene(
            scene,
            A,
            B if self.backgrounds else None,
            **({} if uncertain is None else {"uncertain": uncertain}),
            **_parameters(self.options, options),
        )
        return fitted

    def frames_by(
        self, still: StillMethod[Any], coupling: str, **options: float
    ) -> FrameByFrame[Any, Any]:
        """Return what recovers videos by a method for stills that was fitted by this entry.

        Raises a ValueError if the method recovers none, or if the class rejects an option.
        """
        if self.video is None:
            raise ValueError(f"method '{self.name}' recovers no videos")
        frames: FrameByFrame[Any, Any] = _class(self.video.of)(
            still, coupling=coupling, **_parameters(self.video.options, options)
        )
        return frames

    def of_views(self, fitted: Mapping[str, StillMethod[Any]]) -> Any:
        """Return the method for several views, from itself fitted to each, by camera."""
        return _class(self.views)(fitted)


def _class(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(f"periscopy_sim.reconstruction.{module}"), name)


def _parameters(options: tuple[Option, ...], given: Mapping[str, float]) -> dict[str, float]:
    """Return given values by the names of the class's parameters."""
    names = {option.name: option.parameter or option.name for option in options}
    return {names[name]: value for name, value in given.items()}


# -- the methods ---------------------------------------------------------------------------------


def _tv_weight(unit: str, default: float = 1.0) -> Option:
    return Option("tv_weight", default, "Weight of total variation.", unit=unit)


def _regularization(unit: str, default: float) -> Option:
    return replace(_tv_weight(f"{unit}, above 0", default), least=1e-9, parameter="regularization")


def _l1_weight(default: float) -> Option:
    words = "weight of the l1 difference to the frame before, over that of total variation"
    return Option("l1_weight", default, f"Of the coupling l1: {words}.", coupling="l1")


_IN_ERRORS = _tv_weight("in standard errors of the estimate; 0: none")
_IN_NOISE = _tv_weight("in standard deviations of the noise; 0: none")
_REPAIR = Option(
    "repair_threshold",
    0.1,
    "Repair patches that differ from their neighbours by more than this part of the image's 99th "
    "percentile.",
)
_RANK = Option("rank_tolerance", 1e-10, RANGES["tolerance"].help, *RANGES["tolerance"].ends)


RAYS = 16
"""Rays from each pixel's centre to each patch, in A of methods that want their noise."""

DEFAULT = "noise-aware"
"""Its error is less than `preconditioned`'s in each realistic light of `beyond.noise_aware`."""

_ENTRIES = (
    MethodEntry(
        DEFAULT,
        "models the noise in the photograph, where it is white",
        "noise_aware:NoiseAware",
        bytes_per_entry=8,
        patterns=True,
        options=(_regularization("in ‖A⊥‖_F / σ", 0.02), _RANK),
        certainty="standard errors",
        uncertain=True,
        views="noise_aware_views:NoiseAwareViews",
        video=VideoEntry("noise_aware:NoiseAwareVideo", ("l1", "none"), (_l1_weight(0.8),)),
    ),
    MethodEntry(
        "preconditioned",
        "the paper's",
        "preconditioned:Periscope",
        options=(_IN_ERRORS, _REPAIR, _RANK),
        rays=True,
        video=VideoEntry(
            "preconditioned:Video",
            ("l1", "total-variation", "none"),
            (
                Option(
                    "temporal_weight",
                    1.0,
                    "Of the coupling total-variation: weight of differences in time within it.",
                    coupling="total-variation",
                ),
                _l1_weight(0.4),
            ),
        ),
    ),
    MethodEntry(
        "differencing",
        "of neighbouring pixels, as published in 2019, converged",
        "differencing:Differencing",
        options=(_IN_NOISE,),
    ),
    MethodEntry(
        "truncated-svd",
        "the paper's with A's top singular vectors in place of P",
        "truncated_svd:TruncatedSVD",
        bytes_per_entry=20,
        options=(_IN_ERRORS, _REPAIR),
    ),
    MethodEntry(
        "pseudoinverse",
        "the paper's without backgrounds",
        "preconditioned:Periscope",
        options=(_IN_ERRORS, _REPAIR),
        rays=True,
        backgrounds=False,
    ),
)

METHODS: Mapping[str, MethodEntry] = {entry.name: entry for entry in _ENTRIES}
"""The methods of the package, by name."""

SUCCESSORS = {
    "differencing-published": "differencing, or experiments/paper/as_published.py:Published in a "
    "copy of the repository",
    "iterative": "noise-aware",
    "unrolled": "experiments/learned/unrolled.py:Unrolled in a copy of the repository",
}
"""What takes the place of methods that are gone, by name."""
