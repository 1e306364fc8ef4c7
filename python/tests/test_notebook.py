"""The notebook runs from top to bottom."""

import pathlib

import nbformat
from nbclient import NotebookClient

NOTEBOOK = pathlib.Path(__file__).parents[1] / "examples" / "drive.ipynb"


def test_the_notebook_runs_and_ends_in_pictures(tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.get("outputs") for cell in notebook.cells), "it is kept without outputs"
    first = next(cell for cell in notebook.cells if cell.cell_type == "code")
    assert "SHORT = False" in first.source
    first.source = first.source.replace("SHORT = False", "SHORT = True")
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) == 3
    assert "in the last" in "".join(output.get("text", "") for output in outputs)
