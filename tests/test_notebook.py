"""docs/notebook.ipynb runs, from its first cell to its last, and holds no outputs."""

import json
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parent.parent / "docs" / "notebook.ipynb"
CODE = [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]


def test_it_holds_no_outputs():
    assert CODE and all(cell["outputs"] == [] and cell["execution_count"] is None for cell in CODE)


def test_its_cells_run(monkeypatch, tmp_path, capsys):
    """In one namespace, without a kernel: that would be one more package for the same statements."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    monkeypatch.chdir(NOTEBOOK.parent)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    names = {}
    for i, cell in enumerate(CODE):
        exec(compile("".join(cell["source"]), f"{NOTEBOOK.name}, code cell {i + 1}", "exec"), names)
    said = capsys.readouterr().out
    assert "['absent'] ['init']" in said and "mouth_left" in said
    assert names["after"] < names["before"], said
    assert len(names["wide"].read_text(encoding="utf-8").splitlines()) == 121
    names["plt"].close("all")
