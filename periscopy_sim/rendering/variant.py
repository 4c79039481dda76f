"""Choose a Mitsuba variant: CUDA or Metal where a device answers, else LLVM, else scalar.

This is the only module that calls `mi.set_variant`, and the only one that chooses a libLLVM. In the
scalar variant scenes load, which is all that closed forms need; rays need another.
"""

import os
import platform
import re
import site
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from periscopy_sim.errors import VariantError
from periscopy_sim.extras import installation

PREFERENCE = ("cuda_ad_rgb", "metal_ad_rgb", "llvm_ad_rgb", "scalar_rgb")
OVERRIDE = "PERISCOPY_VARIANT"

OLDEST_LLVM = 17
"""LLVM 15 and 16 load, but abort the process when they compile the path tracer: their x86 backend
cannot select the instruction fminimum."""

LLVM_FILE = "DRJIT_LIBLLVM_PATH"
"""The environment variable that names the libLLVM that Dr.Jit loads."""

_LLVM_OF_SYSTEM = {
    "Linux": f"{installation('llvm')} (x86-64), else apt-get install libllvm19",
    "Darwin": "brew install llvm",
    "Windows": f"github.com/llvm/llvm-project/releases, and its LLVM-C.dll as {LLVM_FILE}",
}
INSTALL_LLVM = (
    f"rays need LLVM {OLDEST_LLVM} or newer, or a GPU: "
    f"{_LLVM_OF_SYSTEM.get(platform.system(), 'conda install libllvm19')}"
)


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


def choose_llvm() -> str:
    """Have Dr.Jit load this environment's libLLVM, and return which one it loads, in words.

    What the user's `LLVM_FILE` names goes before it. Dr.Jit loads its libLLVM as it is imported:
    where ``import mitsuba`` came first, the system's serves, if there is one.
    """
    own = own_llvm()
    if own is not None and "drjit" not in sys.modules:
        os.environ.setdefault(LLVM_FILE, str(own))
    named = os.environ.get(LLVM_FILE)
    if named is None:
        late = f"; call periscopy_sim.use_variant() before importing mitsuba to use {own}"
        return f"the system's{late if own is not None else ''}"
    if named != str(own):
        return f"by {LLVM_FILE}, {named}"
    return f"{named}; this environment's goes before the system's"


def examine_variants() -> list[VariantReport]:
    """Report on each variant in `PREFERENCE`; a VariantError names a library Mitsuba lacks."""
    origin = choose_llvm()
    try:
        import drjit as dr
    except (ImportError, NameError) as error:  # Dr.Jit's own handler of ImportError has a NameError
        install = "install what is missing, such as apt-get install libatomic1"
        raise VariantError(f"Mitsuba: {error.__context__ or error}; {install}") from error

    cuda, metal, llvm = (
        bool(dr.has_backend(getattr(dr.JitBackend, name))) for name in ("CUDA", "Metal", "LLVM")
    )
    version = dr.detail.llvm_version()[0] if llvm else 0
    loaded = f"libLLVM {version} ({origin})" if llvm else f"no libLLVM loads ({origin})"
    works = version >= OLDEST_LLVM
    return [
        VariantReport("cuda_ad_rgb", cuda, f"{'an' if cuda else 'no'} NVIDIA device answers"),
        VariantReport("metal_ad_rgb", metal, f"{'an' if metal else 'no'} Apple device answers"),
        VariantReport("llvm_ad_rgb", works, loaded if works else f"{loaded}; {INSTALL_LLVM}"),
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
        The variant now set.

    Raises
    ------
    VariantError
        If the variant asked for is unknown, is not an RGB variant, or does not work here.
    """
    reports = {report.name: report for report in examine_variants()}
    import mitsuba as mi

    asked = name or os.environ.get(OVERRIDE) or mi.variant()
    if asked is None:
        installed = mi.variants()
        asked = next(each for each in PREFERENCE if reports[each].works and each in installed)
    if asked not in mi.variants() or "_rgb" not in asked:
        usable = ", ".join(variant for variant in mi.variants() if "_rgb" in variant)
        raise VariantError(
            f"'{asked}' is no RGB variant of Mitsuba here; use one of {usable}, or unset {OVERRIDE}"
        )
    report = reports.get(asked)
    if report is not None and not report.works:
        raise VariantError(f"variant '{asked}' does not work here: {report.reason}")
    if mi.variant() != asked:
        mi.set_variant(asked)
    from periscopy_sim.rendering.emitters.lcd import register_lcd

    register_lcd()
    return asked


def is_vectorized() -> bool:
    """Return whether the variant now set evaluates whole arrays at once, as rays need it."""
    import mitsuba as mi

    return not mi.variant().startswith("scalar")


def require_vectorized(purpose: str) -> None:
    """Choose a variant, and raise a VariantError unless it is vectorized; `purpose` is a noun."""
    if use_variant().startswith("scalar"):
        raise VariantError(f"{purpose}: {INSTALL_LLVM}")


_QUIET: list[Any] = []
"""The log levels that `without_warnings` found, the outermost first."""

_QUIET_LOCK = Lock()


@contextmanager
def without_warnings() -> Iterator[None]:
    """Keep Mitsuba from printing what it has already printed of a file, on any thread."""
    import mitsuba as mi

    with _QUIET_LOCK:
        _QUIET.append(mi.log_level())
        mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        with _QUIET_LOCK:
            level = _QUIET.pop()
            if not _QUIET:
                mi.set_log_level(level)


def one_line(error: BaseException) -> str:
    """Return Mitsuba's reason without the source file that complains."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    text = " ".join(lines)
    return text.split("] ", 1)[1] if text.startswith("[") and "] " in text else text
