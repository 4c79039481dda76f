import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import periscopy_sim

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "periscopy_sim"
RENDERERS = {"mitsuba", "drjit"}
# Imports point downwards or stay on their level.
LEVELS = {
    "experiments": 3,
    "__main__": 3,
    "cli": 3,
    "evaluation": 2,
    "dataset": 2,
    "calibration": 2,
    "storage": 2,
    "reconstruction": 1,
    "measurement": 1,
    "defects": 1,
    "rendering": 1,
    "analytic": 1,
    "scenario": 0,
    "shipped": 0,
    "errors": 0,
}
FOR_ALL = {"errors", "shipped"}


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {
    module_name(path): path
    for folder in (PACKAGE, ROOT / "experiments")
    for path in sorted(folder.rglob("*.py"))
}


def imported_names(module, source):
    """Absolute names that a module imports, at any depth, in type checking or by a string."""
    package = module if module in SOURCES and SOURCES[module].stem == "__init__" else None
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = (package or module.rpartition(".")[0]).split(".")
            base = ".".join(parents[: len(parents) - node.level + 1]) if node.level else ""
            base = ".".join(filter(None, [base, node.module]))
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else None
            called = node.func.id if isinstance(node.func, ast.Name) else called
            if called in ("import_module", "__import__"):
                yield str(node.args[0].value)


def part(name):
    """The part of the package that a module belongs to; "" for the package's public face."""
    names = name.split(".")
    if names[0] == "experiments":
        return "experiments"
    return names[1] if len(names) > 1 and names[1] in LEVELS else ""


def broken_arrows(module, source):
    """What a module imports of the package but should not."""
    own = part(module)
    for name in imported_names(module, source):
        if name.split(".")[0] not in ("periscopy_sim", "experiments"):
            continue
        other = part(name)
        if own == "reconstruction":
            allowed = other == "reconstruction"
        elif other == "":
            allowed = LEVELS[own] == 3
        else:
            allowed = other in FOR_ALL or LEVELS[other] <= LEVELS[own]
        forbidden = (own == "analytic" and other == "rendering") or (
            own in FOR_ALL and other not in FOR_ALL
        )
        if forbidden or not allowed:
            yield f"{module} imports {name}"


def test_every_part_of_the_package_has_its_level():
    assert len(SOURCES) > 40
    parts = {name.split(".")[1] for name in SOURCES if name.startswith("periscopy_sim.")}
    assert parts <= LEVELS.keys()


@pytest.mark.parametrize("module", sorted(SOURCES.keys() - {"periscopy_sim"}))
def test_imports_point_one_way(module):
    assert not list(broken_arrows(module, SOURCES[module].read_text("utf-8")))


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("periscopy_sim.reconstruction.repair", "from periscopy_sim.errors import PeriscopyError"),
        ("periscopy_sim.reconstruction.repair", "import periscopy_sim"),
        ("periscopy_sim.reconstruction.repair", "def f():\n    from .. import scenario"),
        ("periscopy_sim.analytic.transport", "from ..rendering import transport"),
        ("periscopy_sim.analytic.transport", "from periscopy_sim import psnr"),
        ("periscopy_sim.scenario", "from .storage.exr import read_exr"),
        ("periscopy_sim.scenario", "if x:\n    import periscopy_sim.measurement as m"),
        ("periscopy_sim.errors", "from periscopy_sim import scenario"),
        ("periscopy_sim.evaluation.metrics", "def f():\n    from periscopy_sim import cli"),
        ("periscopy_sim.storage.exr", "import_module('periscopy_sim.cli.demo')"),
        ("periscopy_sim.dataset", "from experiments import validation"),
    ],
)
def test_a_forbidden_arrow_is_noticed(module, source):
    assert len(list(broken_arrows(module, source))) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("periscopy_sim.reconstruction.repair", "import numpy\nfrom . import video"),
        ("periscopy_sim.analytic.transport", "from periscopy_sim import errors, scenario"),
        ("periscopy_sim.cli.demo", "from periscopy_sim import psnr\nimport periscopy_sim as ps"),
        ("periscopy_sim.evaluation.figures", "from ..storage.srgb import srgb_encode"),
        ("experiments.validation", "import periscopy_sim as ps\nfrom experiments import layout"),
    ],
)
def test_an_allowed_arrow_passes(module, source):
    assert not list(broken_arrows(module, source))


def test_only_the_rendering_and_the_variants_name_need_mitsuba():
    importers = {
        module
        for module, path in SOURCES.items()
        if module.startswith("periscopy_sim")
        and any(
            name.split(".")[0] in RENDERERS
            for name in imported_names(module, path.read_text("utf-8"))
        )
    }
    assert "periscopy_sim.rendering.transport" in importers
    others = {name for name in importers if not name.startswith("periscopy_sim.rendering.")}
    # These ask for the variant's name alone.
    assert others <= {
        "periscopy_sim.cli.scene",
        "periscopy_sim.dataset.inputs",
        "periscopy_sim.storage.ambient_photographs",
    }


def test_only_the_variant_module_sets_the_variant():
    setters = {
        module
        for module, path in SOURCES.items()
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if (isinstance(node, ast.Attribute) and node.attr == "set_variant")
        or (isinstance(node, ast.Constant) and node.value == "set_variant")
        or (isinstance(node, ast.alias) and node.name == "set_variant")
    }
    assert setters == {"periscopy_sim.rendering.variant"}


def test_importing_the_package_imports_no_heavy_library():
    script = (
        "import sys, periscopy_sim; dir(periscopy_sim); "
        "print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    loaded = set(result.stdout.split())
    assert "periscopy_sim" in loaded
    heavy = {"numpy", "scipy", "numba", "matplotlib", "typer", "PIL", "OpenEXR", "png", "tifffile"}
    assert not loaded & (heavy | RENDERERS)


@pytest.mark.parametrize("name", periscopy_sim.__all__)
def test_public_name_resolves_and_is_documented(name):
    thing = getattr(periscopy_sim, name)
    assert thing.__doc__ and thing.__doc__.strip()
    assert thing.__module__.startswith("periscopy_sim.")
    if inspect.isclass(thing):
        # A dataclass without a docstring gets its signature as one.
        assert not thing.__doc__.startswith(f"{name}(")


def test_stub_lists_the_names_that_it_imports():
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text("utf-8"))
    imported = {
        alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert imported == set(periscopy_sim.__all__)
    assert len(imported) > 20


@pytest.mark.parametrize("module", SOURCES)
def test_module_is_short_documented_and_named_for_what_it_holds(module):
    source = SOURCES[module].read_text("utf-8")
    assert len(source.splitlines()) <= 450
    assert ast.get_docstring(ast.parse(source))
    assert not {"utils", "util", "helpers", "common", "misc"} & set(module.split("."))
