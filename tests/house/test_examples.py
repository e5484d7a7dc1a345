"""The notebook runs from its first cell to its last, shows what it says, and is kept without outputs."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

NOTEBOOK = json.loads((Path(__file__).parents[2] / "examples" / "results.ipynb").read_text(encoding="utf-8"))


def shown(source: str, names: dict[str, Any]) -> Any:
    """Run a cell as Jupyter does; the value of its last line, where that is an expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)  # type: ignore[attr-defined]


def test_the_notebook_is_a_notebook_without_outputs() -> None:
    assert (NOTEBOOK["nbformat"], NOTEBOOK["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in NOTEBOOK["cells"]}) == len(NOTEBOOK["cells"])
    for cell in NOTEBOOK["cells"]:
        assert cell["cell_type"] == "markdown" or (cell["outputs"], cell["execution_count"]) == ([], None)


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    with mpl.rc_context({"backend": "agg"}):
        cells = [shown("".join(cell["source"]), names) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
        import matplotlib.pyplot as plt

        plt.close("all")
    assert all(cell is not None for cell in cells)
    drives, metrics, _, pairs, worst, _, _, decisions = cells
    assert len(drives) == 6
    assert metrics.shape == (5, 6)
    assert pairs["dp_qp - idm"].notna().any()
    gaps = names["result"].metrics.query("metric == 'gap.min' and planner == 'dp_qp' and mode == 'closed'")
    assert worst["value"] == gaps["value"].min()
    assert [obstacle.agent for obstacle in names["graph"].obstacles] == ["pedestrian"]
    assert ("pedestrian", "yield") in decisions.index
