"""The notebooks under examples/: they run, and print what is committed."""

import asyncio
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).parent.parent / "examples"
NOTEBOOKS = [pytest.param(path, id=path.stem) for path in sorted(EXAMPLES.glob("*.ipynb"))]


def printed(notebook):
    """The text of every output, cell by cell."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [
        [out.get("text") or out.get("data", {}).get("text/plain", "") for out in cell.outputs]
        for cell in cells
    ]


@pytest.mark.slow  # test_api.py calls the same functions
@pytest.mark.filterwarnings("default")  # jupyter's own
@pytest.mark.parametrize("path", NOTEBOOKS)
def test_a_notebook_prints_what_is_committed(path, tmp_path, monkeypatch):
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    committed = nbformat.read(path, as_version=4)
    again: Any = nbformat.read(path, as_version=4)
    client = NotebookClient(again, timeout=300, resources={"metadata": {"path": str(tmp_path)}})
    asyncio.run(client.async_execute())
    for cell in again.cells:
        if cell.cell_type == "code":
            cell.outputs = [out for out in cell.outputs if out.get("name") != "stderr"]
    assert printed(again) == printed(committed)
