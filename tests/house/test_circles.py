"""No circle of modules: `lint-imports` holds packages, and this test also modules and the `__init__` of their package.

Imports inside functions and under TYPE_CHECKING count as well.
"""

from graphlib import TopologicalSorter
from pathlib import Path
from tomllib import loads

import grimp

ROOT = Path(__file__).parents[2]
LINTER = loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]


def test_no_module_imports_itself_through_others() -> None:
    graph = grimp.build_graph(*LINTER["root_packages"], cache_dir=None)
    assert len(graph.modules) > 350
    imported = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    TopologicalSorter(imported).prepare()  # CycleError names a circle


def test_no_circle_of_packages_is_ignored() -> None:
    (contract,) = (one for one in LINTER["contracts"] if one["type"] == "acyclic_siblings")
    assert contract["ancestors"] == LINTER["root_packages"]
    assert contract.keys() == {"name", "type", "ancestors"}
