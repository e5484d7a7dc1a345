"""A class name means one thing in the packages; a file name repeats only where it names a role."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("logs", "metrics", "planners", "replay", "replan")
MESSAGES = ("logs/mcap/native.py", "replay/planner_process/messages.py")
"""Their classes are nouns on the wire: they have the nouns' names, and are used with the module's name before them."""
ROLES = {"__init__.py", "base.py", "planner.py", "stage.py", "problem.py", "dp.py", "qp.py", "tracks.py"}
COMMANDS = "replay/cli/"
"""A command's file has the name of what it calls."""


def sources() -> list[Path]:
    return [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]


def repeated(named: dict[str, list[str]]) -> dict[str, list[str]]:
    return {name: places for name, places in named.items() if len(places) > 1}


def test_a_class_name_means_one_thing() -> None:
    places = defaultdict(list)
    for file in sources():
        inside = file.relative_to(ROOT).as_posix()
        if inside not in MESSAGES:
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef):
                    places[node.name].append(inside)
    assert len(places) > 500 and not repeated(places)


def test_messages_are_used_with_their_module() -> None:
    of = {inside.removesuffix(".py").replace("/", "."): inside for inside in MESSAGES}
    nouns = {
        module: {
            node.name
            for node in ast.parse((ROOT / inside).read_text(encoding="utf-8")).body
            if isinstance(node, ast.ClassDef)
        }
        for module, inside in of.items()
    }
    bare = [
        (file.relative_to(ROOT).as_posix(), alias.name)
        for file in sources()
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module in of
        for alias in node.names
        if alias.name in nouns[node.module]
    ]
    assert not bare


def test_a_file_name_repeats_only_where_it_is_a_role() -> None:
    places = defaultdict(list)
    for file in sources():
        inside = file.relative_to(ROOT).as_posix()
        if file.name not in ROLES and not inside.startswith(COMMANDS):
            places[file.name].append(inside)
    assert len(places) > 200 and not repeated(places)
