"""The door to Mitsuba: `mi` and `dr` are Mitsuba and Dr.Jit, imported at their first use.

By then a libLLVM and a variant are chosen: CUDA or Metal where a device answers, else LLVM, else
scalar. Only this module imports the two, chooses a libLLVM and sets a variant. In the scalar
variant scenes load, which is all that closed forms need; rays need another.
"""

import os
import platform
import re
import site
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import RLock
from types import ModuleType
from typing import Any

from periscopy_sim.errors import VariantError, installation

PREFERENCE = ("cuda_ad_rgb", "metal_ad_rgb", "llvm_ad_rgb", "scalar_rgb")
OVERRIDE = "PERISCOPY_VARIANT"

OLDEST_LLVM = 17
"""LLVM 15 and 16 load, but abort the process when they compile the path tracer: their x86 backend
cannot select the instruction fminimum."""

LLVM_FILE = "DRJIT_LIBLLVM_PATH"
"""The environment variable that names the libLLVM that Dr.Jit loads."""

LANES = 1 << 22
"""Lanes of a kernel at once, where many kernels make a whole: some 40 bytes each, and a tenth of a
second's wait for an interrupt."""

_LLVM_OF_SYSTEM = {
    "Linux": f"{installation('llvm')} (x86-64), else apt-get install libllvm19",
    "Darwin": "brew install llvm",
    "Windows": f"github.com/llvm/llvm-project/releases, and its LLVM-C.dll as {LLVM_FILE}",
}
_NEED = f"rays need LLVM {OLDEST_LLVM} or newer, or a GPU: "
INSTALL_LLVM = _NEED + _LLVM_OF_SYSTEM.get(platform.system(), "conda install libllvm19")


@dataclass(frozen=True)
class VariantReport:
    """Whether a variant works on this machine."""

    name: str
    works: bool
    reason: str  # what makes it work, or what is missing and how to get it


def own_llvm() -> Path | None:
    """Return the newest libLLVM of this Python environment: of the extra ``llvm``, or conda's."""
    folders = [Path(base, "lib") for base in (sys.prefix, site.getuserbase())]
    files = [file.resolve() for folder in folders for file in folder.glob("libLLVM[-.]*")]
    matches = [(re.match(r"libLLVM\D*(\d+)", file.name), file) for file in files]
    versions = [(int(match[1]), file) for match, file in matches if match]
    version, file = max(versions, default=(0, None))
    return file if version >= OLDEST_LLVM else None


def choose_llvm() -> tuple[str, str]:
    """Have Dr.Jit load this environment's libLLVM.

    What the user's `LLVM_FILE` names goes before it. Dr.Jit loads its libLLVM as it is imported:
    where ``import mitsuba`` came first, the system's serves, if there is one. Return which libLLVM
    Dr.Jit loads, and what to do where that is none or too old.
    """
    own, named = own_llvm(), os.environ.get(LLVM_FILE)
    if own is not None and not named and "drjit" not in sys.modules:
        os.environ[LLVM_FILE] = named = str(own)
    if own is not None and named == str(own):
        return f"{named}; this environment's goes before the system's", INSTALL_LLVM
    if named:
        return f"by {LLVM_FILE}, {named}", f"{_NEED}correct or unset {LLVM_FILE}"
    if own is not None:
        before = "call periscopy_sim.use_variant() before importing mitsuba"
        return "the system's", f"{_NEED}{before} to use {own}"
    return "the system's", INSTALL_LLVM


def examine_variants() -> list[VariantReport]:
    """Report on each variant in `PREFERENCE`; a VariantError names a library Mitsuba lacks."""
    origin, remedy = choose_llvm()
    try:
        import drjit
    except (ImportError, NameError) as error:  # Dr.Jit's own handler of ImportError has a NameError
        install = "install what is missing, such as apt-get install libatomic1"
        raise VariantError(f"Mitsuba: {error.__context__ or error}; {install}") from error

    cuda, metal, llvm = (
        drjit.has_backend(getattr(drjit.JitBackend, name)) for name in ("CUDA", "Metal", "LLVM")
    )
    version = drjit.detail.llvm_version()[0] if llvm else 0
    loaded = f"libLLVM {version} ({origin})" if llvm else f"no libLLVM loads ({origin})"
    works = version >= OLDEST_LLVM
    return [
        VariantReport("cuda_ad_rgb", cuda, f"{'an' if cuda else 'no'} NVIDIA device answers"),
        VariantReport("metal_ad_rgb", metal, f"{'an' if metal else 'no'} Apple device answers"),
        VariantReport("llvm_ad_rgb", works, loaded if works else f"{loaded}; {remedy}"),
        VariantReport("scalar_rgb", True, "needs nothing; for closed forms, it traces no rays"),
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
        The variant now set. One that is unknown, not RGB or does not work here is a VariantError.
    """
    with SHARED:
        reports = {report.name: report for report in examine_variants()}
        import mitsuba

        asked = name or os.environ.get(OVERRIDE) or mitsuba.variant()
        installed = mitsuba.variants()
        if asked is None:
            asked = next(each for each in PREFERENCE if reports[each].works and each in installed)
        if asked not in installed or "_rgb" not in asked:
            usable = ", ".join(variant for variant in installed if "_rgb" in variant)
            raise VariantError(
                f"'{asked}' is no RGB variant of Mitsuba here; use one of {usable}, or unset "
                f"{OVERRIDE}"
            )
        if asked in reports and not reports[asked].works:
            raise VariantError(f"variant '{asked}' does not work here: {reports[asked].reason}")
        if mitsuba.variant() != asked:
            mitsuba.set_variant(asked)
        for register in PLUGINS:
            register(mitsuba)
        _Renderer.ready_for = asked
        return str(asked)


class _Renderer(ModuleType):
    """A module of the renderer, imported and given a variant when an attribute is first used."""

    ready_for = ""
    """The variant whose plugins are registered; a user may have set another since."""

    def __getattr__(self, name: str) -> Any:
        ready_for = _Renderer.ready_for
        if not ready_for or sys.modules["mitsuba"].variant() != ready_for:
            use_variant()
        return getattr(sys.modules[self.__name__], name)


dr, mi = _Renderer("drjit"), _Renderer("mitsuba")

PLUGINS: list[Callable[[Any], None]] = []
"""Functions that register this package's plugins with Mitsuba, again for each variant."""

SHARED = RLock()
"""Held while what all threads share of Mitsuba is changed: its variant, log level and folders."""


def is_vectorized() -> bool:
    """Return whether the variant now set evaluates whole arrays at once, as rays need it."""
    return not mi.variant().startswith("scalar")


def require_vectorized(purpose: str) -> None:
    """Choose a variant, and raise a VariantError unless it is vectorized; `purpose` is a noun."""
    if is_vectorized():
        return
    reports = {report.name: report for report in examine_variants()}
    best = next(name for name in PREFERENCE if reports[name].works)
    reason = f"scalar variants trace no rays; choose {best} ({OVERRIDE}, or use_variant)"
    if best == "scalar_rgb":
        reason = reports["llvm_ad_rgb"].reason
    raise VariantError(f"{purpose}: {reason}")


@contextmanager
def without_warnings() -> Iterator[None]:
    """Keep Mitsuba from printing what it has already printed of a file, on any thread."""
    with SHARED:
        level = mi.log_level()
        mi.set_log_level(mi.LogLevel.Error)
        try:
            yield
        finally:
            mi.set_log_level(level)


def one_line(error: BaseException) -> str:
    """Return Mitsuba's reason without the source file that complains."""
    text = " ".join(str(error).split())
    return text.split("] ", 1)[1] if text.startswith("[") and "] " in text else text
