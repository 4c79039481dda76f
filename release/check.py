"""Build wheel and sdist, and see that each works where it is installed alone.

`python release/check.py [--python EXE ...] [--out DIR]` builds both, checks them by `twine check`,
installs each into a clean environment of each Python, and uses it from a folder outside of the
sources: the import, `periscopy doctor`, a small `periscopy demo`, the shipped scenes. It needs
pip's way to a package index. The exit code is 1 if anything fails.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tarfile
import tempfile
import time
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

BUILDERS = ("build>=1.2", "twine>=6")

SMOKE = """
import importlib.metadata, pathlib, sys, time
start = time.perf_counter()
import periscopy_sim as ps
seconds = time.perf_counter() - start
package = pathlib.Path(ps.__file__).parent
assert pathlib.Path(sys.prefix) in package.parents, package
assert not {'numpy', 'mitsuba', 'matplotlib'} & set(sys.modules)
assert (package / 'py.typed').is_file()
for scene in ('chair', 'plate', 'plant', 'bright_room', 'doorway', 'ambient/overcast'):
    assert package in ps.find_scene(scene).parents, scene
assert package in ps.find_image('mushroom').parents
assert all(getattr(ps, name).__doc__ for name in ps.__all__)
print(f"periscopy_sim {importlib.metadata.version('periscopy-sim')}, imported in {seconds:.2f} s")
"""

IN_WHEEL = (
    "periscopy_sim/py.typed",
    "periscopy_sim/__init__.pyi",
    "periscopy_sim/storage/published.toml",
    "periscopy_sim/scenes/chair.xml",
    "periscopy_sim/scenes/images/mushroom.png",
)
IN_SDIST = ("README.md", "CHANGELOG.md", "LICENSE", "Makefile", "tests/conftest.py", *IN_WHEEL[:2])
NEVER = ("/.git/", "/.venv/", "__pycache__", "/out/", ".pyc")


def main() -> int:
    """Check the distributions; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--python", nargs="+", default=[sys.executable], help="interpreters")
    parser.add_argument("--out", type=Path, help="folder to keep what is built in")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="periscopy_release_") as name:
        folder = Path(name)
        built = (asked.out or folder / "dist").resolve()
        built.mkdir(parents=True, exist_ok=True)
        tools = environment(folder / "tools", sys.executable)
        run(tools, "-m", "pip", "install", "--quiet", *BUILDERS)
        run(tools, "-m", "build", "--outdir", str(built), str(ROOT))
        wheel, sdist = (newest(built, pattern) for pattern in ("*.whl", "*.tar.gz"))
        run(tools, "-m", "twine", "check", "--strict", str(wheel), str(sdist))
        check_contents(wheel, sdist)
        failed = 0
        for python in asked.python:
            for distribution in (wheel, sdist):
                what = f"{distribution.name} on {Path(python).name}"
                try:
                    seconds, size = tried(distribution, python, folder)
                except (subprocess.CalledProcessError, OSError) as error:
                    print(f"FAILED: {what}: {error}", flush=True)
                    failed += 1
                    continue
                print(f"works: {what}: {size:.0f} MB installed, {seconds:.0f} s", flush=True)
    return 1 if failed else 0


def tried(distribution: Path, python: str, folder: Path) -> tuple[float, float]:
    """Install a distribution alone and use it; return seconds and megabytes."""
    start = time.perf_counter()
    place = Path(tempfile.mkdtemp(dir=folder))
    alone = environment(place / "venv", python)
    before = megabytes(place / "venv")
    run(alone, "-m", "pip", "install", "--quiet", f"{distribution}[llvm]")
    run(alone, "-m", "pip", "check")
    elsewhere = place / "elsewhere"
    elsewhere.mkdir()
    run(alone, "-c", SMOKE, cwd=elsewhere)
    command = next(alone.parent.glob("periscopy*"))
    for arguments in (
        ("--version",),
        ("doctor",),
        ("demo", "--hidden", "6x8", "--resolution", "24", "--effort", "0.01", "--out", "demo"),
    ):
        call([str(command), *arguments], elsewhere)
    if not (elsewhere / "demo" / "demo.png").is_file():
        raise OSError("periscopy demo wrote no demo.png")
    return time.perf_counter() - start, megabytes(place / "venv") - before


def check_contents(wheel: Path, sdist: Path) -> None:
    """Refuse distributions that lack what is used, or hold what is nobody's business."""
    held = {"wheel": set(zipfile.ZipFile(wheel).namelist())}
    with tarfile.open(sdist) as archive:
        held["sdist"] = {member.partition("/")[2] for member in archive.getnames()}
    for kind, needed in (("wheel", IN_WHEEL), ("sdist", IN_SDIST)):
        missing = [name for name in needed if name not in held[kind]]
        strange = [name for name in held[kind] if any(each in f"/{name}" for each in NEVER)]
        if missing or strange:
            raise SystemExit(f"{kind}: lacks {missing}, holds {strange}")
    if strange := [n for n in held["wheel"] if n.startswith(("tests/", "experiments/"))]:
        raise SystemExit(f"wheel: holds {strange[:3]}")
    for file in (wheel, sdist):
        print(f"{file.name}: {file.stat().st_size / 1e6:.1f} MB", flush=True)


def environment(folder: Path, python: str) -> Path:
    """Make an environment of an interpreter; return its own interpreter."""
    if python == sys.executable:
        venv.create(folder, with_pip=True)
    else:
        subprocess.run([python, "-m", "venv", str(folder)], check=True)
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def run(python: Path, *arguments: str, cwd: Path | None = None) -> None:
    """Run an interpreter apart from the sources, and from what the caller's environment says."""
    call([str(python), *arguments], cwd)


def call(command: list[str], cwd: Path | None) -> None:
    """Run a command to its end; a CalledProcessError says that it failed."""
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    subprocess.run(command, cwd=cwd or Path(tempfile.gettempdir()), env=clean, check=True)


def newest(folder: Path, pattern: str) -> Path:
    """Return the latest file of a pattern."""
    return max(folder.glob(pattern), key=lambda file: file.stat().st_mtime)


def megabytes(folder: Path) -> float:
    """Return the size of all files below a folder."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


if __name__ == "__main__":
    sys.exit(main())
