"""Signatures and docstrings of subclasses, with the parameters that they inherit."""

import inspect
import re
from collections.abc import Iterator
from typing import Any


class Documented:
    """A class whose subclasses name all their parameters and attributes, the inherited ones too."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "__init__" in vars(cls):
            setattr(cls, "__signature__", _signature(cls))  # noqa: B010
        for section in ("Parameters", "Attributes"):
            cls.__doc__ = _with_inherited(cls, section)


def _signature(cls: Any) -> inspect.Signature:
    """Return a constructor's signature with the names of its ``**keywords``."""
    _, *own = inspect.signature(cls.__init__).parameters.values()
    if not (own and own[-1].kind is inspect.Parameter.VAR_KEYWORD):
        return inspect.Signature(own)
    own.pop()
    names, keyword = {each.name for each in own}, inspect.Parameter.KEYWORD_ONLY
    inherited = inspect.signature(cls.__mro__[1]).parameters.values()
    own += [each for each in inherited if each.kind is keyword and each.name not in names]
    return inspect.Signature(own)


def _with_inherited(cls: type, section: str) -> str:
    """Return a class's docstring with the entries of its bases in a section of NumPy's style."""
    doc, *inherited = (inspect.cleandoc(each.__doc__ or "") for each in cls.__mro__)
    known = {name for names, _ in _entries(doc, section) for name in names}
    wanted = inspect.signature(cls).parameters if section == "Parameters" else None
    added = []
    for names, entry in (each for text in inherited for each in _entries(text, section)):
        if not names & known and (wanted is None or names & wanted.keys()):
            added.append(entry)
            known |= names
    title = f"{section}\n{'-' * len(section)}\n"
    entries = title + "\n".join(added)
    if not added:
        return doc
    if title in doc:
        return doc.replace(title, f"{entries}\n", 1)
    head, errors, rest = doc.partition("Raises\n------\n")
    return f"{head.rstrip()}\n\n{entries}\n\n{errors}{rest}".rstrip()


def _entries(doc: str, section: str) -> Iterator[tuple[set[str], str]]:
    """Yield the names and the text of each entry in a section."""
    body = re.search(rf"^{section}\n-+\n(.*?)(?=\n\n\w+\n---|\Z)", doc, re.MULTILINE | re.DOTALL)
    for entry in re.split(r"\n(?=\S)", body[1]) if body else []:
        yield set(entry.partition("\n")[0].split(", ")), entry
