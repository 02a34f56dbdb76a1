"""The cells of the notebooks run from top to bottom, in the plain interpreter without Jupyter."""

import ast
import json
import os
import re
import subprocess
import sys
from typing import Any

import pytest

from operator_app.cli import main
from operator_app.manual.pages import NOTEBOOKS

NAMES = sorted(f.name for f in NOTEBOOKS.iterdir() if f.name.endswith(".ipynb"))


def run_cell(source: str, names: dict[str, Any]) -> Any:
    """Run a cell and return the value of a final expression, as a notebook shows it."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)  # noqa: S102 - the notebook
    if last is None:
        return None
    assert isinstance(last, ast.Expr)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)  # noqa: S307


@pytest.mark.parametrize("name", NAMES)
def test_cells_run_in_order(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    values = []
    for cell in json.loads((NOTEBOOKS / name).read_text())["cells"]:
        if cell["cell_type"] == "code":
            values.append(run_cell("".join(cell["source"]), names))
    output = capsys.readouterr().out
    match name:
        case "own_readings.ipynb":
            result = names["result"]
            assert result.accepted
            tables = [s._repr_html_() for s in values if hasattr(s, "_repr_html_")]
            assert any("<table" in table for table in tables)
            error = abs(result.values["theta_off_2_deg"] - names["made"].truth["theta_off_2_deg"])
            assert error < 4 * result.sigmas["theta_off_2_deg"]
            assert "theta_off_2_deg" in output
            assert main(["report", "my_calibration", "--text"]) == 0
        case "what_moved.ipynb":
            assert "theta_off_3" in str(names["found"].drifted)
            moved, sigma = (float(n) for n in re.findall(r"-?\d\.\d+", output))
            assert moved == pytest.approx(-0.5, abs=3 * sigma)


@pytest.mark.parametrize("name", NAMES)
def test_notebook_is_valid_without_outputs(name):
    """Format 4.5, with unique ids."""
    notebook = json.loads((NOTEBOOKS / name).read_text())
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    for cell in notebook["cells"]:
        assert cell["cell_type"] in ("code", "markdown")
        assert cell.get("outputs", []) == []


def test_help_writes_the_notebooks(tmp_path):
    code = "import sys; from operator_app.cli import main; sys.exit(main())"
    words = [sys.executable, "-c", code, "help", "notebooks", "--files", str(tmp_path / "here")]
    subprocess.run(words, check=True, capture_output=True, env=os.environ)
    assert sorted(p.name for p in (tmp_path / "here").iterdir()) == NAMES
