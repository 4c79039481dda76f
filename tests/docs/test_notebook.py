"""The notebook for a first hour."""

import ast
import json

import pytest

import periscopy_sim as ps
from tests.docs import ROOT, names_taken

NOTEBOOK = ROOT / "docs" / "first_hour.ipynb"


def test_notebook_takes_public_names_and_keeps_no_output():
    cells = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    for cell in code:
        assert not cell["outputs"] and cell["execution_count"] is None, "clear its outputs"
    source = "\n".join("".join(cell["source"]) for cell in code).replace("%matplotlib inline", "")
    assert names_taken(ast.parse(source)) <= set(ps.__all__)


@pytest.mark.slow
def test_notebook_runs(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(
        notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in shown) >= 6
