"""The methods by name: what each is, the options it takes, and what recovers videos by it.

A new method is one file with its class, a `StillMethod`, and one entry in `METHODS`. The command
line, the sweeps and their help follow from the entry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.method import Seen, StillMethod
from periscopy_sim.reconstruction.observation import Mask
from periscopy_sim.reconstruction.video_method import FrameByFrame

Matrix = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Option:
    """A number that a method can be given.

    Attributes
    ----------
    name
        Its name for users, on the command line and in summaries.
    default
        What the method takes if it is not given.
    least, most
        Its bounds.
    help
        What it does, and what is special about 0 or the like.
    unit
        What it counts in with this method, for the help; empty where that goes without saying.
    parameter
        The parameter of the class that takes it; empty if it has the option's name.
    coupling
        The coupling of a video's frames that it belongs to; empty if it is of none.
    """

    name: str
    default: float
    least: float
    most: float
    help: str
    unit: str = ""
    parameter: str = ""
    coupling: str = ""


@dataclass(frozen=True)
class VideoEntry:
    """How a method recovers videos.

    Attributes
    ----------
    of
        ``module:class`` within `periscopy_sim.reconstruction`, a `FrameByFrame` that takes the
        method for stills and the keyword ``coupling``.
    couplings
        How a frame can be tied to the one before it.
    options
        What else the class takes.
    """

    of: str
    couplings: tuple[str, ...]
    options: tuple[Option, ...] = ()


@dataclass(frozen=True)
class MethodEntry:
    """A method of the package; called, it is fitted to a scene.

    Attributes
    ----------
    name
        Its name for users.
    help
        What it is, in a few words.
    of
        ``module:class`` within `periscopy_sim.reconstruction`, a `StillMethod`; imported when used.
    options
        What users can set.
    certainty
        What it can tell of its certainty, in a few words; empty for nothing.
    fixed
        Parameters of the class that make this method of it.
    backgrounds
        Whether it is told the prototype backgrounds.
    video
        How it recovers videos; None if it does not.
    """

    name: str
    help: str
    of: str
    options: tuple[Option, ...] = ()
    certainty: str = ""
    fixed: Mapping[str, Any] = field(default_factory=dict)
    backgrounds: bool = True
    video: VideoEntry | None = None

    def __call__(
        self, scene: Seen, A: Matrix, B: Matrix, mask: Mask | None = None, **options: float
    ) -> StillMethod[Any]:
        """Fit the method to a scene.

        Parameters
        ----------
        scene
            A `Scenario`, or anything with its sizes and the colour of its wall.
        A
            (M, N) light transport matrix.
        B
            (M, L) prototype backgrounds.
        mask
            (rows, columns), True where the wall is used; None for everywhere.
        **options
            Values of `options`, by their names.

        Raises
        ------
        ValueError
            As the class does.
        """
        fitted: StillMethod[Any] = _class(self.of).for_scene(
            scene,
            A,
            B if self.backgrounds else None,
            mask=mask,
            **self.fixed,
            **_parameters(self.options, options),
        )
        return fitted

    def frames_by(
        self, still: StillMethod[Any], coupling: str, **options: float
    ) -> FrameByFrame[Any, Any]:
        """Return what recovers videos by a method for stills that was fitted by this entry.

        Raises
        ------
        ValueError
            If the method recovers none, or as the class does.
        """
        if self.video is None:
            raise ValueError(f"method '{self.name}' recovers no videos")
        parameters = _parameters(self.video.options, options)
        frames: FrameByFrame[Any, Any] = _class(self.video.of)(
            still, coupling=coupling, **parameters
        )
        return frames


def _class(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(f"periscopy_sim.reconstruction.{module}"), name)


def _parameters(options: tuple[Option, ...], given: Mapping[str, float]) -> dict[str, float]:
    """Return given values by the names of the class's parameters."""
    names = {option.name: option.parameter or option.name for option in options}
    return {names[name]: value for name, value in given.items()}


# -- the methods ---------------------------------------------------------------------------------

_TV_WEIGHT = Option("tv_weight", 1.0, 0, 1e9, "Weight of total variation; 0: none.")
_IN_ERRORS = replace(_TV_WEIGHT, unit="in standard errors of the estimate")
_IN_NOISE = replace(_TV_WEIGHT, unit="in standard deviations of the noise")
_REPAIR = Option(
    "repair_threshold",
    0.1,
    0,
    1e9,
    "Repair patches that differ from their neighbours by more than this part of the image's 99th "
    "percentile.",
)
_RANK = Option(
    "rank_tolerance", 1e-10, 1e-15, 0.5, "Singular values of B that are kept, over the largest."
)
_L1_WEIGHT = Option(
    "l1_weight",
    0.4,
    0,
    1e9,
    "Weight of the l1 difference to the frame before, over that of total variation.",
    coupling="l1",
)
_TEMPORAL_WEIGHT = Option(
    "temporal_weight",
    1.0,
    0,
    1e9,
    "Weight of differences in time within total variation.",
    coupling="total-variation",
)

DEFAULT = "noise-aware"
"""Of less error under every realistic light tried than the paper's (`beyond.noise_aware`)."""

_ENTRIES = (
    MethodEntry(
        DEFAULT,
        "the noise taken where it is white, in the photograph",
        "noise_aware.still:NoiseAware",
        options=(
            replace(
                _TV_WEIGHT,
                default=0.02,
                least=1e-9,
                unit="in ‖A⊥‖_F / σ, positive",
                parameter="regularization",
            ),
            _RANK,
        ),
        certainty="standard errors",
        video=VideoEntry(
            "noise_aware.video:NoiseAwareVideo",
            ("l1", "none"),
            (replace(_L1_WEIGHT, default=0.8),),
        ),
    ),
    MethodEntry(
        "preconditioned",
        "the paper's",
        "preconditioned.still:Periscope",
        options=(_IN_ERRORS, _REPAIR, _RANK),
        video=VideoEntry(
            "preconditioned.video:Video",
            ("l1", "total-variation", "none"),
            (_TEMPORAL_WEIGHT, _L1_WEIGHT),
        ),
    ),
    MethodEntry(
        "iterative",
        "the paper's problem without P, for fine grids",
        "large_scale.iterative:IterativePeriscope",
        options=(
            replace(_TV_WEIGHT, default=0.015, unit="in σ ‖A⊥‖_F", parameter="regularization"),
            _RANK,
        ),
    ),
    MethodEntry(
        "differencing",
        "of neighbouring pixels, as published in 2019, converged",
        "baselines.differencing:Differencing",
        options=(_IN_NOISE,),
    ),
    MethodEntry(
        "differencing-published",
        "the same, stopped where the published code stops",
        "baselines.differencing:Differencing",
        options=(_IN_NOISE,),
        fixed={"stop": "published"},
    ),
    MethodEntry(
        "truncated-svd",
        "the paper's with A's top singular vectors in place of P",
        "baselines.truncated_svd:TruncatedSVD",
        options=(_IN_ERRORS, _REPAIR),
    ),
    MethodEntry(
        "pseudoinverse",
        "the paper's without backgrounds",
        "preconditioned.still:Periscope",
        options=(_IN_ERRORS, _REPAIR),
        backgrounds=False,
    ),
)

METHODS: Mapping[str, MethodEntry] = {entry.name: entry for entry in _ENTRIES}
"""The methods of the package, by name."""
