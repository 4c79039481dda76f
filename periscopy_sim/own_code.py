"""A user's own methods and cameras, as ``module:callable`` or ``path/to/file.py:callable``."""

import inspect
import runpy
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from periscopy_sim.errors import PeriscopyError

OwnError = (Exception, SystemExit)
"""Errors of a user's code that end nothing else; `sys.exit` in it is such an error."""

PACKAGE = Path(__file__).parent


@dataclass(frozen=True)
class OwnCode:
    """A user's own code by its name; messages say what it is, such as "method".

    Modules of the working folder are found too.
    """

    kind: str
    name: str

    @property
    def place(self) -> str:
        """The module or file."""
        return self.name.rpartition(":")[0]

    @property
    def attribute(self) -> str:
        """What it is called there."""
        return self.name.rpartition(":")[2]

    @property
    def is_complete(self) -> bool:
        """Whether the name has both parts."""
        return bool(self.place) and all(map(str.isidentifier, self.attribute.split(".")))

    @property
    def file(self) -> Path | None:
        """The file, where the module has one."""
        is_file = self.place.endswith(".py")
        file = self.place if is_file else self._definitions().get("__file__")
        return Path(file) if file else None

    def load(self) -> Any:
        """Return the callable; a PeriscopyError says that it does not exist."""
        try:
            defined: Any = SimpleNamespace(**self._definitions())
            return reduce(getattr, self.attribute.split("."), defined)
        except AttributeError as error:
            raise PeriscopyError(
                f"{self.kind} '{self.name}': there is no '{self.attribute}'; check the name"
            ) from error

    def _definitions(self) -> dict[str, Any]:
        """Return what the module or the file defines.

        No other code can import what a file defines, so that pickle sends its definitions along
        with its objects, to workers that have no such file.
        """
        path = Path(self.place).resolve()
        sys.path.insert(0, str(path.parent))
        try:
            with own_errors(f"{self.kind} '{self.name}' cannot be imported", path):
                if path.suffix == ".py":
                    return runpy.run_path(self.place, run_name=f"{path.stem} of {path}")
                return vars(import_module(self.place))
        finally:
            sys.path.remove(str(path.parent))


def place_of(function: Callable[..., Any]) -> str:
    """Return the file and the first line of a function, in brackets; empty where it has none."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    code = code or getattr(type(function).__call__, "__code__", None)
    return f" ({Path(code.co_filename).name}:{code.co_firstlineno})" if code else ""


@contextmanager
def own_errors(failure: str, file: Path | None = None) -> Iterator[None]:
    """Turn any error of a user's own code into a PeriscopyError that says where it arose.

    It names the failure, the error, and the last line of a file in its traceback: None for the
    first file that is not of this package. A lack of memory passes.
    """
    try:
        yield
    except MemoryError:  # says more about the machine than about the code
        raise
    except OwnError as error:
        frames = [
            (Path(each.filename).resolve(), each.lineno)
            for each in traceback.extract_tb(error.__traceback__)
        ]
        outside = (path for path, _ in frames if PACKAGE not in path.parents)
        file = file.resolve() if file else next(outside, None)
        lines = [line for path, line in frames if path == file]
        where = f" ({file.name}:{lines[-1]})" if file and lines else ""
        raise PeriscopyError(f"{failure}: {type(error).__name__}: {error}{where}") from error
