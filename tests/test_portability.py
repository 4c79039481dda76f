"""Nothing here is known to break on Windows or macOS, or by another locale than the author's."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("periscopy_sim", "experiments", "benchmarks", "scenes")
SOURCES = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]

# Modules and names that only POSIX has, or that mean something else elsewhere.
POSIX_MODULES = {"fcntl", "termios", "pwd", "grp", "resource", "posix", "pty", "syslog"}
POSIX_NAMES = {
    "os": {"fork", "getuid", "geteuid", "getpgid", "killpg", "mkfifo", "setsid", "uname", "wait"},
    "signal": {"SIGKILL", "SIGHUP", "SIGALRM", "SIGUSR1", "SIGUSR2", "SIGPIPE", "alarm", "pause"},
}
# What only Linux tells, by scripts that measure memory or are run on purpose.
MEASURING = {
    "benchmarks/entry.py",
    "experiments/benchmarks/fine_grids.py",
    "experiments/benchmarks/scale.py",
}


@cache
def nodes_of(source):
    return [*ast.walk(ast.parse(source))]


def place(path):
    return path.relative_to(ROOT).as_posix()


def unencoded(source):
    """Lines that read or write text in whichever encoding the machine has."""
    for node in nodes_of(source):
        if not isinstance(node, ast.Call):
            continue
        called = node.func
        name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
        holder = getattr(called, "value", None)
        owner = getattr(holder, "id", getattr(holder, "attr", ""))
        told = any(keyword.arg == "encoding" for keyword in node.keywords)
        constants = [arg.value for arg in node.args if isinstance(arg, ast.Constant)]
        if name == "read_text" and not (told or node.args):
            yield node.lineno
        if name == "write_text" and not told and len(node.args) < 2:
            yield node.lineno
        if name == "open" and owner not in ("Image", "os", "zarr", "zip", "av", "webbrowser"):
            mode = [c for c in constants if isinstance(c, str) and set(c) <= set("rwaxbt+")]
            mode += [k.value.value for k in node.keywords if k.arg == "mode"]
            is_binary = any("b" in each for each in mode)
            if not (told or is_binary):
                yield node.lineno


def posix_only(source):
    """Names that another system has not, but where a branch asks for the system first."""
    asked = {
        id(inner)
        for node in nodes_of(source)
        if isinstance(node, ast.If | ast.IfExp)
        and ("platform" in ast.unparse(node.test) or "hasattr" in ast.unparse(node.test))
        for inner in ast.walk(node)
    }
    for node in nodes_of(source):
        if id(node) in asked:
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            modules = [alias.name for alias in node.names]
            modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            yield from (f"{node.lineno}: {name}" for name in modules if name in POSIX_MODULES)
        if isinstance(node, ast.Attribute):
            owner = getattr(node.value, "id", "")
            if node.attr in POSIX_NAMES.get(owner, ()):
                yield f"{node.lineno}: {owner}.{node.attr}"


def test_text_is_read_and_written_in_a_named_encoding():
    found = {place(path): [*unencoded(path.read_text("utf-8"))] for path in SOURCES}
    assert not {path: lines for path, lines in found.items() if lines}


def test_nothing_of_posix_alone_is_used_where_the_system_is_not_asked():
    found = {
        place(path): names
        for path in SOURCES
        if not any(place(path).startswith(each) for each in MEASURING)
        and (names := list(posix_only(path.read_text("utf-8"))))
    }
    assert not found
