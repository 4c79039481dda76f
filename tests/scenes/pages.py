"""What the tests of pages, gallery and notebook share."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]


def names_taken(tree):
    """Return the names that code takes of the package, as ``ps.NAME``."""
    return {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "ps"
    }
