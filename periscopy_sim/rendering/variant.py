"""Choose a Mitsuba variant: CUDA where a device answers, else LLVM, else scalar.

This is the only module that calls `mi.set_variant`.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass

from periscopy_sim.errors import VariantError

PREFERENCE = ("cuda_ad_rgb", "llvm_ad_rgb", "scalar_rgb")
OVERRIDE = "PERISCOPY_VARIANT"

OLDEST_LLVM = 17
"""LLVM 15 and 16 load, but abort the process when they compile the path tracer: their x86 backend
cannot select the instruction fminimum."""

INSTALL_LLVM = (
    f"install LLVM {OLDEST_LLVM} or newer (Debian, Ubuntu: apt-get install libllvm19; macOS: brew "
    "install llvm; elsewhere set DRJIT_LIBLLVM_PATH to its libLLVM) to render about 100 times "
    "faster"
)


@dataclass(frozen=True)
class VariantReport:
    """Whether a variant works on this machine.

    Attributes
    ----------
    name
        Mitsuba's name of the variant.
    works
        Whether scenes can be rendered with it here.
    reason
        What makes it work, or what is missing and how to mend it.
    """

    name: str
    works: bool
    reason: str


def examine_variants() -> list[VariantReport]:
    """Report on the variants that this package prefers, best first.

    Returns
    -------
    list of VariantReport
        One entry for each name in `PREFERENCE`.
    """
    import drjit as dr

    cuda = bool(dr.has_backend(dr.JitBackend.CUDA))
    found = bool(dr.has_backend(dr.JitBackend.LLVM))
    version = dr.detail.llvm_version()[0] if found else 0
    if version >= OLDEST_LLVM:
        llvm = f"libLLVM {version} was found"
    elif found:
        llvm = f"libLLVM {version} is too old for Mitsuba's path tracer: {INSTALL_LLVM}"
    else:
        llvm = f"no libLLVM was found, or one too old for Dr.Jit: {INSTALL_LLVM}"
    return [
        VariantReport(
            "cuda_ad_rgb",
            cuda,
            "an NVIDIA device answers" if cuda else "no NVIDIA device or driver answers",
        ),
        VariantReport("llvm_ad_rgb", version >= OLDEST_LLVM, llvm),
        VariantReport("scalar_rgb", True, "needs nothing; about 100 times slower than LLVM"),
    ]


def use_variant(name: str | None = None) -> str:
    """Set the Mitsuba variant and register this package's plugins with it.

    Precedence: `name`, then the environment variable ``PERISCOPY_VARIANT``, then the variant that
    the user already set, then the first of `PREFERENCE` that works here.

    Parameters
    ----------
    name
        A Mitsuba variant; None chooses.

    Returns
    -------
    str
        The variant now set.

    Raises
    ------
    VariantError
        If the variant asked for is unknown, is not an RGB variant, or does not work here.

    Warns
    -----
    RuntimeWarning
        If the slow scalar variant is all that works here.
    """
    import mitsuba as mi

    asked = name or os.environ.get(OVERRIDE) or mi.variant()
    if asked is None:
        asked = next(report.name for report in examine_variants() if report.works)
        if asked == "scalar_rgb":
            warnings.warn(f"rendering with scalar_rgb: {INSTALL_LLVM}", RuntimeWarning, 2)
    _check(asked)
    if mi.variant() != asked:
        mi.set_variant(asked)
    from periscopy_sim.rendering.emitters.lcd import register_lcd

    register_lcd()
    return asked


def is_vectorized() -> bool:
    """Tell whether the variant now set evaluates whole arrays at once (LLVM or CUDA)."""
    import mitsuba as mi

    return not mi.variant().startswith("scalar")


def _check(name: str) -> None:
    import mitsuba as mi

    if name not in mi.variants():
        raise VariantError(
            f"unknown Mitsuba variant '{name}'; installed here: {', '.join(mi.variants())}; "
            f"name one of these, or unset {OVERRIDE}"
        )
    if "_rgb" not in name:
        raise VariantError(f"variant '{name}' is not an RGB variant; use one of {PREFERENCE}")
    for report in examine_variants():
        if not report.works and name.split("_")[0] == report.name.split("_")[0]:
            raise VariantError(f"variant '{name}' does not work here: {report.reason}")
