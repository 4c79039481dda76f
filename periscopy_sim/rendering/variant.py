"""Choose a Mitsuba variant: CUDA where a device answers, else LLVM, else scalar.

This is the only module that calls `mi.set_variant`.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass

from periscopy_sim.errors import VariantError

FIXED_BLOCKS = {"block_size": 32}
"""Of Mitsuba's integrators, by its default: in scalar variants each block of pixels has a seed of
its own, and blocks of no fixed size follow the number of threads."""

PREFERENCE = ("cuda_ad_rgb", "llvm_ad_rgb", "scalar_rgb")
OVERRIDE = "PERISCOPY_VARIANT"

OLDEST_LLVM = 17
"""LLVM 15 and 16 load, but abort the process when they compile the path tracer: their x86 backend
cannot select the instruction fminimum."""

LLVM_FILE = "DRJIT_LIBLLVM_PATH"
"""The environment variable that names the libLLVM that Dr.Jit loads."""


@dataclass(frozen=True)
class VariantReport:
    """Whether a variant works on this machine."""

    name: str
    works: bool
    reason: str  # what makes it work, or what is missing and how to get it


def examine_variants() -> list[VariantReport]:
    """Return what there is to say of the variants in `PREFERENCE`, best first."""
    import drjit as dr

    cuda = bool(dr.has_backend(dr.JitBackend.CUDA))
    version = dr.detail.llvm_version()[0] if dr.has_backend(dr.JitBackend.LLVM) else 0
    if version >= OLDEST_LLVM:
        llvm = f"libLLVM {version} was found"
    elif version:
        llvm = f"libLLVM {version} is too old for Mitsuba's path tracer; {install_llvm()}"
    else:
        llvm = f"no libLLVM loads that Dr.Jit can use; {install_llvm()}"
    device = "an NVIDIA device answers" if cuda else "no NVIDIA device or driver answers"
    return [
        VariantReport("cuda_ad_rgb", cuda, device),
        VariantReport("llvm_ad_rgb", version >= OLDEST_LLVM, llvm),
        VariantReport("scalar_rgb", True, "needs nothing; about 100 times slower than LLVM"),
    ]


def install_llvm() -> str:
    """Return how to install a libLLVM that serves."""
    return (
        f"install LLVM {OLDEST_LLVM} or newer to render about 100 times faster (Debian, Ubuntu: "
        "apt-get install libllvm19; macOS: brew install llvm; conda: libllvm19 of conda-forge; "
        "Windows: the installer from github.com/llvm/llvm-project/releases); where Dr.Jit does not "
        f"find it, set {LLVM_FILE} to its libLLVM.so, libLLVM.dylib or LLVM-C.dll"
    )


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
    reports = {report.name.split("_")[0]: report for report in examine_variants()}
    if asked is None:
        asked = next(report.name for report in reports.values() if report.works)
        if asked == "scalar_rgb":
            why = reports["llvm"].reason
            warnings.warn(f"rendering with scalar_rgb: {why}", RuntimeWarning, 2)
    if asked not in mi.variants():
        raise VariantError(
            f"unknown Mitsuba variant '{asked}'; installed here: {', '.join(mi.variants())}; "
            f"name one of these, or unset {OVERRIDE}"
        )
    if "_rgb" not in asked:
        raise VariantError(f"variant '{asked}' is not an RGB variant; use one of {PREFERENCE}")
    report = reports.get(asked.split("_")[0])
    if report is not None and not report.works:
        raise VariantError(f"variant '{asked}' does not work here: {report.reason}")
    if mi.variant() != asked:
        mi.set_variant(asked)
    from periscopy_sim.rendering.emitters.lcd import register_lcd

    register_lcd()
    return asked


def is_vectorized() -> bool:
    """Return whether the variant now set evaluates whole arrays at once (LLVM or CUDA)."""
    import mitsuba as mi

    return not mi.variant().startswith("scalar")


def require_vectorized(purpose: str) -> None:
    """Choose a variant, and raise a VariantError unless it is vectorized; `purpose` is a noun."""
    use_variant()
    if not is_vectorized():
        raise VariantError(f"{purpose} needs llvm_ad_rgb or cuda_ad_rgb: {install_llvm()}")
