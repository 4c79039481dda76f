"""Choose a Mitsuba variant: CUDA where a device answers, else LLVM, else scalar.

This is the only module that calls `mi.set_variant`.
"""

from __future__ import annotations

import os
import platform
import warnings
from dataclasses import dataclass

from periscopy_sim.errors import VariantError

FIXED_BLOCKS = {"block_size": 32}
"""Of Mitsuba's integrators: in scalar variants each block of pixels has a seed of its own, and
their size follows the number of threads where none is given."""

PREFERENCE = ("cuda_ad_rgb", "llvm_ad_rgb", "scalar_rgb")
OVERRIDE = "PERISCOPY_VARIANT"

OLDEST_LLVM = 17
"""LLVM 15 and 16 load, but abort the process when they compile the path tracer: their x86 backend
cannot select the instruction fminimum."""

LLVM_FILE = "DRJIT_LIBLLVM_PATH"
"""The environment variable by which Dr.Jit is told which libLLVM to load."""


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
    found = bool(dr.has_backend(dr.JitBackend.LLVM))
    version = dr.detail.llvm_version()[0] if found else 0
    if version >= OLDEST_LLVM:
        llvm = f"libLLVM {version} was found"
    elif found:
        llvm = f"libLLVM {version} is too old for Mitsuba's path tracer; {install_llvm()}"
    else:
        llvm = f"no libLLVM loads that Dr.Jit can use; {install_llvm()}"
    return [
        VariantReport(
            "cuda_ad_rgb",
            cuda,
            "an NVIDIA device answers" if cuda else "no NVIDIA device or driver answers",
        ),
        VariantReport("llvm_ad_rgb", version >= OLDEST_LLVM, llvm),
        VariantReport("scalar_rgb", True, "needs nothing; about 100 times slower than LLVM"),
    ]


def install_llvm() -> str:
    """Return how a libLLVM that serves is installed on this system."""
    if platform.system() == "Windows":
        way = (
            "run the installer from github.com/llvm/llvm-project/releases, then set "
            f"{LLVM_FILE} to its LLVM-C.dll, such as C:\\Program Files\\LLVM\\bin\\LLVM-C.dll"
        )
    elif conda := os.environ.get("CONDA_PREFIX"):
        way = (
            f"conda install -c conda-forge libllvm19, then set {LLVM_FILE} to the libLLVM in "
            f"{conda}/lib"
        )
    elif platform.system() == "Darwin":
        way = (
            f"brew install llvm; if it is not found, set {LLVM_FILE} to "
            "$(brew --prefix llvm)/lib/libLLVM.dylib"
        )
    else:
        way = (
            "Debian, Ubuntu: apt-get install libllvm19; elsewhere by its package manager, then set "
            f"{LLVM_FILE} to its libLLVM.so"
        )
    return f"install LLVM {OLDEST_LLVM} or newer to render about 100 times faster ({way})"


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
        reports = {report.name: report for report in examine_variants()}
        asked = next(name for name, report in reports.items() if report.works)
        if asked == "scalar_rgb":
            why = reports["llvm_ad_rgb"].reason
            warnings.warn(f"rendering with scalar_rgb: {why}", RuntimeWarning, 2)
    _check(asked)
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
