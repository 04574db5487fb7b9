"""The quickstart notebook runs from top to bottom and makes its pictures, film and runs."""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parent.parent / "zoo" / "quickstart.ipynb"
SECONDS = 120  # limit of a cell


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Jupyter's own packages
        import nbformat
        from nbclient import NotebookClient

        shutil.copy(NOTEBOOK, tmp_path)
        notebook = nbformat.read(tmp_path / NOTEBOOK.name, as_version=4)
        NotebookClient(notebook, timeout=SECONDS, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [set(output.get("data", ())) for cell in notebook.cells for output in cell.get("outputs", ())]
    assert sum("image/png" in kinds for kinds in shown) == 3, "the robot, the curve, the paths of one's own task"
    assert (tmp_path / "drive.mp4").stat().st_size > 50_000
    assert len(list(tmp_path.glob("runs/quickstart/*/best/policy.safetensors"))) == 2
