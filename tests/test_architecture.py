"""The house's rules: imports point one way, Mitsuba has one home, names tell what they hold."""

import ast
import inspect
import itertools
import re
import subprocess
import sys
from collections import Counter
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
import typer

import periscopy_sim
from periscopy_sim.cli import MODULES, app

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "periscopy_sim"
RENDERERS = {"mitsuba", "drjit"}
HEAVY = {
    *("numpy", "scipy", "numba", "matplotlib", "typer", "PIL", "OpenEXR", "png", "tifffile"),
    *("ruamel", "zarr", "xarray", "distributed"),
}
STANDING_APART = "experiments.laboratories.making"
"""What renders stand-ins knows nothing of the package; the room around it chooses a libLLVM."""
OF_OUTPUT = {"matplotlib", "zarr", "xarray", "distributed"}
# From the top floor down: a part imports from its own floor and from those below.
FLOORS = [
    {"experiments"},
    {"__main__", "cli"},
    {"live"},
    {"figures", "evaluation", "dataset", "laboratory", "adapters", "deepinv"},
    {"scenario"},
    {"judgement"},
    {"calibration", "methods", "memo", "light"},
    {"storage"},
    {"photographs", "rendering", "analytic", "reconstruction", "measurement"},
    {"model"},
    {"photograph", "hidden", "view", "scene", "shipped", "testing"},
    {"numerics", "errors"},
]
MAKERS = {"rendering", "analytic", "model"}
DOCTOR = "periscopy_sim.cli.start"
FLOOR = {part: -level for level, parts in enumerate(FLOORS) for part in parts}


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {
    module_name(path): path
    for folder in (PACKAGE, ROOT / "experiments")
    for path in sorted(folder.rglob("*.py"))
}


@cache
def tree_of(module):
    return ast.parse(SOURCES[module].read_text("utf-8"))


@cache
def nodes_of(tree):
    return [*ast.walk(tree)]


@cache
def imported_names(module, tree):
    """Absolute names that a module imports, at any depth, in type checking or by a string."""
    return [*_imported(module, tree)]


def _imported(module, tree):
    package = module if module in SOURCES and SOURCES[module].stem == "__init__" else None
    for node in nodes_of(tree):
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
    return names[1] if len(names) > 1 and names[1] in FLOOR else ""


def broken_arrows(module, tree):
    """What a module imports of the package but should not."""
    own = part(module)
    for name in imported_names(module, tree):
        if name.split(".")[0] not in ("periscopy_sim", "experiments"):
            continue
        other = part(name)
        if other == "":
            allowed = own in ("experiments", "cli", "__main__")
        else:
            allowed = FLOOR[other] <= FLOOR[own]
        if own in ("reconstruction", "model"):  # arrays in, arrays out
            allowed = other in (own, "model", "photograph", "hidden", "numerics")
        if own == "analytic" and other == "rendering":  # twins that check each other
            allowed = False
        if own in ("cli", "live") and other in MAKERS and module != DOCTOR:  # a scenario makes all
            allowed = False
        if not allowed:
            yield f"{module} imports {name}"


def module_of(name):
    """The module that an imported name lies in; None outside this repository."""
    while name and name not in SOURCES:
        name = name.rpartition(".")[0]
    return name or None


def test_every_part_of_the_package_has_its_floor():
    assert len(SOURCES) > 40
    parts = {name.split(".")[1] for name in SOURCES if name.startswith("periscopy_sim.")}
    assert parts <= FLOOR.keys()


def test_imports_point_one_way():
    broken = [
        arrow
        for module in SOURCES
        if module != "periscopy_sim"
        for arrow in broken_arrows(module, tree_of(module))
    ]
    assert not broken, "\n".join(broken)


def test_no_import_goes_in_a_circle():
    """Not even through imports within functions."""
    arrows = {
        module: {
            other
            for name in imported_names(module, tree_of(module))
            if (other := module_of(name)) not in (None, module)
            # A package's own face says nothing of its rooms.
            and SOURCES[other].stem != "__init__"
        }
        for module in SOURCES
    }
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def importers_of(libraries):
    return {
        module
        for module in SOURCES
        if any(name.split(".")[0] in libraries for name in imported_names(module, tree_of(module)))
    }


def test_mitsuba_and_matplotlib_have_one_door_each():
    """Behind it a libLLVM and a variant are chosen, and no backend is asked for."""
    importers = {m for m in importers_of(RENDERERS) if not m.startswith(STANDING_APART)}
    assert importers == {"periscopy_sim.rendering.variant"}
    assert importers_of({"matplotlib"}) == {"periscopy_sim.figures.style"}


def test_only_the_command_line_writes_of_its_commands_and_options():
    """Other rooms state facts and name parameters; `cli.messages` gives advice about options."""
    parser = typer.main.get_command(app)
    commands = [parser.get_command(None, name) for name in MODULES]
    names = {name for each in commands for option in each.params for name in option.opts}
    options = "|".join(n for n in names if n.startswith("--") or n == "-D")
    flags = re.compile(rf"(^|[\s('])({options})\b|['`]periscopy ({'|'.join(MODULES)})\b")
    described = {
        id(node.value)
        for module in SOURCES
        for node in nodes_of(tree_of(module))
        if isinstance(node, ast.Expr)
    }
    mentions = [
        f"{module}: {node.value}"
        for module in SOURCES
        if module.startswith("periscopy_sim.") and part(module) != "cli"
        for node in nodes_of(tree_of(module))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        if " " in node.value and id(node) not in described and flags.search(node.value)
    ]
    assert not mentions, "\n".join(mentions)


def test_only_the_variant_module_sets_the_variant():
    setters = {
        module
        for module in SOURCES
        for node in nodes_of(tree_of(module))
        if (isinstance(node, ast.Attribute) and node.attr == "set_variant")
        or (isinstance(node, ast.Constant) and node.value == "set_variant")
        or (isinstance(node, ast.alias) and node.name == "set_variant")
    }
    assert setters == {"periscopy_sim.rendering.variant", f"{STANDING_APART}.render"}


READERS = "storage.provenance", "storage.photographs"
HELP = "import typer; p = typer.main.get_command(app); [p.get_command(None, n) for n in MODULES]"


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("import periscopy_sim; dir(periscopy_sim)", HEAVY),
        (f"from periscopy_sim.cli import MODULES, app; {HELP}", HEAVY - {"numpy", "typer"}),
        (f"import {', '.join(f'periscopy_sim.{name}' for name in READERS)}", HEAVY - {"numpy"}),
        ("from periscopy_sim.methods import *; find_method('differencing')", OF_OUTPUT),
        ("import periscopy_sim.evaluation.sweep", OF_OUTPUT),
    ],
)
def test_no_import_brings_in_a_heavy_library_before_it_is_needed(code, heavy):
    script = f"import sys; {code}; print(*{{name.partition('.')[0] for name in sys.modules}})"
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    loaded = set(result.stdout.split())
    assert "periscopy_sim" in loaded
    assert loaded & (heavy | RENDERERS) == set()


@pytest.mark.filterwarnings("ignore:use ps:DeprecationWarning")
def test_public_names_resolve_and_are_documented():
    """On every machine, whichever optional dependencies it has."""
    for name in periscopy_sim.__all__:
        thing = getattr(periscopy_sim, name)
        assert thing.__doc__ and thing.__doc__.strip(), name
        assert thing.__module__.startswith("periscopy_sim."), name
        if inspect.isclass(thing):
            # A dataclass without a docstring gets its signature as one.
            assert not thing.__doc__.startswith(f"{name}("), name


@pytest.mark.filterwarnings("ignore:use ps:DeprecationWarning")
def test_pages_of_classes_list_the_parameters_of_their_constructors():
    for name, thing in ((name, getattr(periscopy_sim, name)) for name in periscopy_sim.__all__):
        if not inspect.isclass(thing) or issubclass(thing, Exception):
            continue
        pages = (inspect.cleandoc(each.__doc__ or "").splitlines() for each in thing.__mro__)
        documented = {
            each.lstrip("*")
            for lines in pages
            for line in lines
            for each in line.partition(" :")[0].split(", ")
        }
        assert inspect.signature(thing).parameters.keys() <= documented, name


@pytest.mark.parametrize("name", ["World", "Sweep", "run_sweep"])
def test_former_names_serve_one_more_version(name, monkeypatch):
    monkeypatch.delitem(vars(periscopy_sim), name, raising=False)  # loaded before
    with pytest.warns(DeprecationWarning, match=f"ps.sweep; ps.{name} "):
        assert getattr(periscopy_sim, name).__name__ == name


def test_names_given_to_functions_leave_their_docstrings():
    """Sphinx shows a string below an assignment in place of the docstring."""
    for module, path in SOURCES.items():
        body = tree_of(module).body
        for node, following in itertools.pairwise(body):
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Name):
                assert not isinstance(following, ast.Expr), f"{path}:{node.lineno}"


def test_stub_lists_the_names_that_it_imports():
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text("utf-8"))
    imported = {
        alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert imported == set(periscopy_sim.__all__)
    assert len(imported) > 20


def test_tests_share_scenes_and_import_no_other_tests():
    """A fixture, or a module of `tests/scenes`; else the tests of one room depend on another's."""
    borrowed = [
        f"{path.name}: {line}"
        for path in (ROOT / "tests").rglob("*.py")
        for line in re.findall(r"^\s*(?:from|import) tests\b.*", path.read_text("utf-8"), re.M)
        if "tests.scenes" not in line
    ]
    assert not borrowed


def test_modules_are_short_documented_and_named_for_what_they_hold():
    for module, path in SOURCES.items():
        assert len(path.read_text("utf-8").splitlines()) <= 700, module
        assert ast.get_docstring(tree_of(module)), module
        assert not {"utils", "util", "helpers", "common", "misc"} & set(module.split(".")), module


def test_no_two_public_classes_have_one_name():
    names = Counter(
        node.name
        for module in SOURCES
        if module.startswith("periscopy_sim.")
        for node in tree_of(module).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert not {name for name, count in names.items() if count > 1}
