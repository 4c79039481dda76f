import ast
import json
import re

import pytest

import periscopy_sim as ps
from tests.scenes.pages import ROOT, names_taken

EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(EXAMPLES.rglob("*.py"))


def tree_of(script):
    return ast.parse(script.read_text("utf-8"))


CONFIGURATION = (ROOT / "docs" / "conf.py").read_text("utf-8")


def test_scripts_are_listed_take_public_names_assert_and_draw_from_a_seed():
    listed = re.findall(r'"(\w+)"', re.search(r"for name in \((.*?)\)", CONFIGURATION)[1])
    for script in SCRIPTS:
        assert script.parent.name in listed and script.parent.parent == EXAMPLES
        assert (script.parent / "GALLERY_HEADER.rst").is_file()
        tree = tree_of(script)
        taken = names_taken(tree)
        assert taken and taken <= set(ps.__all__), taken - set(ps.__all__)
        nodes = [*ast.walk(tree)]
        assert any(isinstance(node, ast.Assert) for node in nodes), script
        for node in nodes:
            if isinstance(node, ast.ImportFrom):
                assert not (node.module or "").startswith("periscopy_sim"), script
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func)
                if name.endswith("default_rng"):
                    assert node.args, f"{script}: {ast.unparse(node)}"
                if name == "ps.add_noise":
                    assert {"seed"} <= {keyword.arg for keyword in node.keywords}, script
                assert not name.startswith("np.random.") or name.endswith("default_rng"), script


NOTEBOOK = ROOT / "docs" / "first_hour.ipynb"


def test_notebook_takes_public_names_and_keeps_no_output():
    cells = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    for cell in code:
        assert not cell["outputs"] and cell["execution_count"] is None, "clear its outputs"
    source = "\n".join("".join(cell["source"]) for cell in code).replace("%matplotlib inline", "")
    assert names_taken(ast.parse(source)) <= set(ps.__all__)


@pytest.mark.slow
def test_notebook_runs(tmp_path, monkeypatch):
    pytest.importorskip("xarray")
    mpl = pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    mpl.use("agg")
    from matplotlib import pyplot as plt

    cells, names = json.loads(NOTEBOOK.read_text("utf-8"))["cells"], {}
    try:
        for cell in cells:
            if cell["cell_type"] == "code":
                exec("".join(cell["source"]).replace("%matplotlib inline", ""), names)
        assert len(plt.get_fignums()) >= 6
    finally:
        plt.close("all")
