"""docs/architecture.md lists the files on the way of one log.

No circle of modules; names that mean one thing.
"""

import ast
import json
import re
import subprocess
import sys
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from tomllib import loads

from short_logs import short

from replan.logs.mcap import write_scenario

ROOT = Path(__file__).parents[2]
MOST_FILES = 25
TRACED = """
import json, sys
import replan.draw.recording, replan.draw.report, replan.run
from replan.cli import app

ROOT, found = sys.argv[1], {}
PACKAGES = ("logs/", "metrics/", "planners/", "replay/", "replan/")


def ours(frame):
    name = frame.f_code.co_filename.removeprefix(ROOT)
    return name if name.startswith(PACKAGES) and frame.f_code.co_name != "<module>" else ""


def called(frame, event, _):
    if event == "call" and (file := ours(frame)) and file not in found:
        found[file], caller = set(), frame.f_back
        while caller is not None:
            found[file].add(ours(caller))
            caller = caller.f_back


sys.setprofile(called)
try:
    app(sys.argv[2:], prog_name="replan")
except SystemExit as end:
    code = end.code
sys.setprofile(None)
print(json.dumps({"code": code, "found": {file: sorted(callers - {""}) for file, callers in found.items()}}))
"""  # noqa: E501


def test_the_way_of_one_log_is_the_files_that_the_page_lists(tmp_path: Path) -> None:
    """Law: each listed file is called, and between the command and its first call there are listed
    files only.
    """
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    steps = page[page.index("## One log through") : page.index("## Where is")]
    listed = set(re.findall(r"`([\w/]+\.py)`", steps))
    assert len(listed) <= MOST_FILES and f"is {len(listed)} files" in steps
    write_scenario(tmp_path / "a.mcap", short("test/a", parked=True))
    command = [
        "evaluate",
        str(tmp_path / "a.mcap"),
        "--out",
        str(tmp_path / "out"),
        "--workers",
        "0",
    ]
    python = [sys.executable, "-c", TRACED, f"{ROOT}/"]
    done = subprocess.run([*python, *command], cwd=ROOT, capture_output=True, text=True, check=True)
    run = json.loads(done.stdout.splitlines()[-1])
    assert run["code"] in (0, 1, 4), done.stderr
    assert listed <= run["found"].keys()
    on_the_way = {caller for file in listed for caller in run["found"][file]}
    assert on_the_way <= listed, on_the_way - listed


LINTER = loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]


GRAPH = """
import grimp, json, sys
graph = grimp.build_graph(*sys.argv[1:], cache_dir=None)
print(json.dumps({module: sorted(graph.find_modules_directly_imported_by(module)) for module in graph.modules}))
"""  # noqa: E501
"""Run in build/ns, where the packages lie under their names (`.ci/links.py`)."""


def test_no_module_imports_itself_through_others() -> None:
    command = [sys.executable, "-c", GRAPH, *LINTER["root_packages"]]
    done = subprocess.run(
        command, cwd=ROOT / "build" / "ns", capture_output=True, text=True, check=True
    )
    imported = json.loads(done.stdout)
    assert len(imported) > 350
    TopologicalSorter(imported).prepare()  # CycleError names a circle


def test_no_circle_of_packages_is_ignored() -> None:
    (contract,) = (one for one in LINTER["contracts"] if one["type"] == "acyclic_siblings")
    assert contract["ancestors"] == LINTER["root_packages"]
    assert contract.keys() == {"name", "type", "ancestors"}


PACKAGES = ("logs", "metrics", "planners", "replay", "replan")
MESSAGES = (
    "logs/mcap/native.py",
    "logs/mcap/plan_messages.py",
    "replay/planner_process/messages.py",
)
"""Their classes are nouns on the wire: they have the nouns' names, and are used with the module's
name before them.
"""
ROLES = {
    "__init__.py",
    "base.py",
    "planner.py",
    "stage.py",
    "problem.py",
    "dp.py",
    "qp.py",
    "tracks.py",
}
COMMANDS = "replan/cli/"
"""A command's file has the name of what it calls."""


def sources() -> list[str]:
    files = (file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py")))
    return [file.relative_to(ROOT).as_posix() for file in files]


def repeated(named: dict[str, list[str]]) -> dict[str, list[str]]:
    return {name: places for name, places in named.items() if len(places) > 1}


@cache
def syntax(inside: str) -> tuple[list[str], list[tuple[str | None, str]]]:
    """The classes that a source defines, and modules and names that it imports from."""
    nodes = list(ast.walk(ast.parse((ROOT / inside).read_text(encoding="utf-8"))))
    imports = [
        (node.module, alias.name)
        for node in nodes
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    ]
    return [node.name for node in nodes if isinstance(node, ast.ClassDef)], imports


def test_a_class_name_means_one_thing() -> None:
    places = defaultdict(list)
    for inside in sources():
        for name in syntax(inside)[0] if inside not in MESSAGES else ():
            places[name].append(inside)
    assert len(places) > 500 and not repeated(places)


def test_messages_are_used_with_their_module() -> None:
    nouns = {inside.removesuffix(".py").replace("/", "."): syntax(inside)[0] for inside in MESSAGES}
    for inside in sources():
        bare = [name for module, name in syntax(inside)[1] if name in nouns.get(module or "", ())]
        assert not bare, inside


def test_a_file_name_repeats_only_where_it_is_a_role() -> None:
    places = defaultdict(list)
    for inside in sources():
        name = inside.rpartition("/")[2]
        if name not in ROLES and not inside.startswith(COMMANDS):
            places[name].append(inside)
    assert len(places) > 200 and not repeated(places)
