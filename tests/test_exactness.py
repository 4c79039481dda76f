"""No test compares rounded results exactly: other processors sum in another order, or fuse."""

import ast
from pathlib import Path

SUMS = {"dot", "vdot", "einsum", "matmul", "tensordot", "norm", "mean", "std", "var"}
HARMLESS = {"shape", "dtype", "ndim", "size", "approx", "round", "int", "len", "tobytes"}


def is_rounded(node, rounded=frozenset()):
    """Return whether a value is a matrix product, a mean, a sum of products, or such a name."""
    match node:
        case ast.Attribute(attr=name) | ast.Call(func=ast.Name(id=name)) if name in HARMLESS:
            return False
        case ast.Call(func=ast.Attribute(attr=name)) if name in SUMS | HARMLESS:
            return name in SUMS
        case ast.Call(func=ast.Attribute(attr="sum")):
            kinds = {type(each) for each in ast.walk(node)}
            return bool(kinds & {ast.Mult, ast.Pow}) and ast.Compare not in kinds
        case ast.BinOp(op=ast.MatMult()):
            return True
        case ast.Name(id=name):
            return name in rounded
        case ast.Compare() | ast.JoinedStr() | ast.Call() | ast.Lambda():
            return False
    return any(is_rounded(each, rounded) for each in ast.iter_child_nodes(node))


def exact_comparisons(test):
    """Yield the lines of a test that assert equality of rounded results."""
    nodes = list(ast.walk(test))
    assigned = [each for each in nodes if isinstance(each, ast.Assign) and is_rounded(each.value)]
    targets = [name for each in assigned for target in each.targets for name in ast.walk(target)]
    rounded = {name.id for name in targets if isinstance(name, ast.Name)}
    for node in (inner for each in nodes if isinstance(each, ast.Assert | ast.Expr)
                 for inner in ast.walk(each)):  # fmt: skip
        match node:
            case ast.Compare(left=left, ops=[ast.Eq() | ast.NotEq(), *_], comparators=others):
                sides = [left, *others]
            case ast.Call(func=ast.Attribute(attr=name)) if name.endswith("_equal"):
                sides = node.args[:2]
            case _:
                continue
        computed = any(isinstance(each, ast.BinOp) for each in sides)
        decimals = [e for e in sides if isinstance(e, ast.Constant) and isinstance(e.value, float)]
        at_risk = (computed and decimals) or any(is_rounded(each, rounded) for each in sides)
        if at_risk and "approx(" not in ast.unparse(node):
            yield node.lineno


def test_no_rounded_result_is_compared_exactly():
    """Two runs of the same code may be: a comment marks the line with "the same bits"."""
    exact, folder = set(), Path(__file__).parent
    for path in folder.rglob("*.py"):
        text = path.read_text("utf-8")
        tests = [each for each in ast.walk(ast.parse(text)) if isinstance(each, ast.FunctionDef)]
        lines = {line for test in tests for line in exact_comparisons(test)}
        marked = {k for k, line in enumerate(text.splitlines(), 1) if "the same bits" in line}
        exact |= {f"{path.relative_to(folder)}:{line}" for line in lines - marked}
    assert exact == set()
