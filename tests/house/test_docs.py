"""What README and documentation show is run: commands and programs of a page in order, in a folder
of its own.

Every file, module, option and link that they name exists.

A block that is not run says why in a comment before it, `<!-- not run: REASON -->`; a command that
ends with another exit code than 0 says so behind it, `# exit code 1`. A program is a file whose
name is its first line.
"""

import re
import shlex
import shutil
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from command_line import replan
from typer.main import get_command

from replan.cli import app
from replan.logs.readers import readers

ROOT = Path(__file__).parents[2]
PAGES = (
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "examples").rglob("*.md")),
    *(ROOT / name for name in ("tests/verdicts.md", "benchmarks/README.md", "studies/README.md")),
)
FENCE = re.compile(
    r"(?:<!-- not run: (?P<why>[^\n]+?) -->\n)?^ *```(?P<kind>\w*)\n(?P<text>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)
EXIT = re.compile(r"# exit code (\d)")
OPTION = re.compile(r"--[a-z][\w-]*")


class Block(NamedTuple):
    """A block of a page: its language, text, and why it is not run."""

    kind: str
    text: str
    why: str | None


def blocks(page: Path, *kinds: str) -> list[Block]:
    found = FENCE.finditer(page.read_text(encoding="utf-8"))
    made = [Block(m["kind"], textwrap.dedent(m["text"]), m["why"]) for m in found]
    return [block for block in made if block.kind in kinds]


def file_name(block: Block) -> str | None:
    """The file that a block is, if its first line names one."""
    m = re.fullmatch(r"# (\S+\.(?:py|toml|yml))", block.text.partition("\n")[0])
    return m and m[1]


def commands(page: Path) -> Iterator[tuple[list[str], int]]:
    """Words and exit code of every command of a page that is run, in order."""
    for block in blocks(page, "sh"):
        for line in block.text.replace("\\\n", " ").splitlines() if block.why is None else ():
            if words := shlex.split(line, comments=True):
                yield words, int(m[1]) if (m := EXIT.search(line)) else 0


def named(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


FIRST = ("README.md", "docs/start.md")
"""The pages that a newcomer follows first: their commands run on every change, those of the others
at night.
"""


def with_commands() -> list[Any]:
    found = [page for page in PAGES if any(commands(page))]
    return [
        page if named(page) in FIRST else pytest.param(page, marks=pytest.mark.nightly)
        for page in found
    ]


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with nothing in it but the examples, from which programs find ours."""
    for example in (ROOT / "examples").glob("*.py"):
        (tmp_path / example.name).write_bytes(example.read_bytes())
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def put_files(page: Path, folder: Path) -> None:
    if page.parent.parent == ROOT / "examples":
        shutil.copytree(page.parent, folder, dirs_exist_ok=True)
    for block in blocks(page, "python", "toml"):
        if block.why is None and (name := file_name(block)):
            (folder / name).write_text(block.text, encoding="utf-8")


def run(words: list[str]) -> tuple[int, str]:
    """A command, quickly: replan in this process, without recordings."""
    program, *rest = words
    if program == "replan":
        extra = ["--workers", "0", "--no-recording"] if rest[0] == "evaluate" else []
        result = replan(*rest, *extra)
        return result.exit_code, result.output
    assert program == "python", f"{shlex.join(words)}: say why it is not run"
    done = subprocess.run([sys.executable, *rest], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("page", with_commands(), ids=named)
def test_every_command_runs_in_order(page: Path, desk: Path) -> None:
    before = set(sys.modules)
    put_files(page, desk)
    try:
        for words, code in commands(page):
            if words[:2] == ["replan", "view"]:
                continue  # a viewer is a window: tests/replay has what it opens
            exit_code, said = run(words)
            assert exit_code == code, f"{shlex.join(words)}: {said}"
    finally:
        readers.cache_clear()  # two pages may have a reader of one name
        for name in set(sys.modules) - before:
            if Path(getattr(sys.modules[name], "__file__", None) or "/").is_relative_to(desk):
                del sys.modules[name]


@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page, "python", "toml")], ids=named
)
def test_programs_and_settings_are_whole(page: Path, desk: Path) -> None:
    """Programs compile; those without a name run; settings are TOML."""
    put_files(page, desk)
    for block in blocks(page, "toml"):
        assert tomllib.loads(block.text)
    for block in blocks(page, "python"):
        compile(block.text, page.name, "exec")
        if block.why is None and file_name(block) is None:
            done = subprocess.run(
                [sys.executable, "-c", block.text], capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr


def test_every_program_of_a_page_is_run() -> None:
    """A named program is run by a command of its page, or is a module that a command or another
    program names.
    """
    for page in PAGES:
        said = " ".join(" ".join(words) for words, _ in commands(page))
        programs = [
            block for block in blocks(page, "python") if block.why is None and file_name(block)
        ]
        for block in programs:
            name = Path(file_name(block) or "").stem
            others = [other.text for other in programs if other is not block]
            assert re.search(rf"\b{name}\b", said + " ".join(others)), (
                f"{page.name}: {name}.py is run by nothing"
            )


def shown_commands(page: Path) -> Iterator[list[str]]:
    """The words of every `replan ...` of a page, run or not: in blocks, indented, and in the
    text.
    """
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    fenced = "\n".join(block.text for block in blocks(page, "sh")).replace("\\\n", " ")
    lines = re.findall(r"^ *(replan .+)$", fenced, re.MULTILINE) + re.findall(
        r"^ {4,}(replan .+)$", text, re.MULTILINE
    )
    lines += re.findall(r"`(replan [^`]+)`", text)
    for line in lines:
        yield shlex.split(line.replace("\n", " "), comments=True)[1:]


command_line = cache(lambda: get_command(app))


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_option_of_a_shown_command_exists(page: Path) -> None:
    root = command_line()
    for words in shown_commands(page):
        command, rest = root, words
        while rest and rest[0] in getattr(command, "commands", {}):
            command, rest = command.commands[rest[0]], rest[1:]
        assert command is not root or words[0].startswith("-"), (
            f"replan {shlex.join(words)}: no such command"
        )
        known = {
            option
            for param in (*command.params, *root.params)
            for option in (*param.opts, *param.secondary_opts)
        }
        asked = {word.partition("=")[0] for word in rest if re.match(r"--?[a-zA-Z]", word)}
        assert asked <= known | {"--help", "-h"}, f"replan {shlex.join(words)}: {asked - known}"


def test_shown_code_is_fenced_as_a_language() -> None:
    """Code in no language would be run by nothing."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"^ *```(?:bash|shell|console|py)$", text, re.MULTILINE), page.name


# names of files, modules, options and anchors that the pages show ---------------------------------

FOLDERS = (
    ".ci",
    ".github",
    "benchmarks",
    "ci",
    "docs",
    "examples",
    "logs",
    "metrics",
    "planners",
    "replan",
    "replay",
    "studies",
    "tests",
)
FILES = {path.name for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
NAMED = [page for page in PAGES if page.name != "CHANGELOG.md"]
"""Pages whose names are those of today: the changelog has names of earlier versions, too."""
CODE = re.compile(r"`([^`\n]+)`")
PATH = re.compile(rf"(?:{'|'.join(map(re.escape, FOLDERS))})/[\w./-]*")
MODULE = re.compile(r"(?:logs|metrics|planners|replan|replay|studies|benchmarks)(?:\.\w+)+")
ENDINGS = ("csv", "parquet", "md", "json", "toml", "whl", "opendrive", "s3", "ray", "foxglove")
"""Words behind a dot that make a name one of a file or an entry point, and not of a module."""


def code_names(page: Path) -> Iterator[str]:
    """What stands in backticks in the text, what commands run as a Python file or module, and what
    `:::` documents.
    """
    text = page.read_text(encoding="utf-8")
    yield from (name for line in CODE.findall(FENCE.sub("", text)) for name in line.split())
    yield from re.findall(r"(?:python (?:-m )?|^::: )([\w./]+)", text, re.MULTILINE)


def is_defined(module: str) -> bool:
    """Whether a dotted name is a module of ours, or a name at the top of one."""
    parts = module.split(".")
    for count in range(len(parts), 0, -1):
        place = ROOT.joinpath(*parts[:count])
        file = next(
            (f for f in (place.with_suffix(".py"), place / "__init__.py") if f.is_file()), None
        )
        if file is not None or place.is_dir():
            text = "" if file is None else file.read_text(encoding="utf-8")
            return all(re.search(rf"\b{name}\b", text) for name in parts[count : count + 1])
    return False


@cache
def users_files() -> set[str]:
    """The files of a user that the pages show, and one that they warn of."""
    shown = {file_name(block) for page in PAGES for block in blocks(page, "python", "toml", "yaml")}
    return {name for name in shown if name} | {"metrics.py"}


@pytest.mark.parametrize("page", NAMED, ids=named)
def test_every_file_and_module_that_a_page_names_exists(page: Path) -> None:
    for name in code_names(page):
        path = name.partition("::")[0]
        if PATH.fullmatch(path):
            assert (ROOT / path).exists() or path in users_files(), name
        elif re.fullmatch(r"\w+\.py", name):
            assert name in FILES | users_files(), name
        elif MODULE.fullmatch(name) and name.rpartition(".")[2] not in ENDINGS:
            assert is_defined(name), name


@pytest.mark.parametrize("page", NAMED, ids=named)
def test_every_test_that_a_page_names_exists(page: Path) -> None:
    """`path::name`, or `::name` of the file before it."""
    file = ""
    for path, name in re.findall(
        r"`(tests/[\w/]+\.py)?(?:::(\w+))?`", page.read_text(encoding="utf-8")
    ):
        if path or name:
            file = path or file
            assert not name or f"def {name}(" in (ROOT / file).read_text(encoding="utf-8"), (
                f"{file}::{name}"
            )


def anchors(page: Path) -> set[str]:
    heads = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", head).strip().lower()) for head in heads}


@pytest.mark.parametrize("page", NAMED, ids=named)
def test_every_link_of_a_page_leads_somewhere(page: Path) -> None:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = link.partition("#")
        goal = page if not path else (page.parent / path)
        assert "://" in link or goal.exists(), link
        assert not anchor or "://" in link or anchor in anchors(goal), link


def all_options(command: Any) -> set[str]:
    own = {option for param in command.params for option in (*param.opts, *param.secondary_opts)}
    return own.union(*(all_options(sub) for sub in getattr(command, "commands", {}).values()))


def test_every_option_in_the_text_is_one_of_replan_or_of_a_command_shown_there() -> None:
    options = all_options(command_line()) | {"--help"}
    for page in NAMED:
        text = page.read_text(encoding="utf-8")
        shown = {
            option
            for line in re.findall(r"\b(?:pip|python|git|docker|ssh)\b.*", text)
            for option in OPTION.findall(line)
        }
        named_here = {
            name.partition("=")[0]
            for name in code_names(page)
            if OPTION.fullmatch(name.partition("=")[0])
        }
        assert named_here <= options | shown, f"{page.name}: {named_here - options - shown}"


def test_every_option_of_a_program_of_ours_is_in_its_source() -> None:
    """`python benchmarks/reading.py --hour`, `python -m studies.invariance --only 5_hz`."""
    found = 0
    for page in NAMED:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for name, rest in re.findall(r"python (?:-m )?([\w./]+)([^\n`#]*)", text):
            file = ROOT / (name if name.endswith(".py") else f"{name.replace('.', '/')}.py")
            for option in OPTION.findall(rest) if file.is_file() else ():
                found += 1
                assert f'"{option}"' in file.read_text(encoding="utf-8"), (
                    f"{page.name}: {name} {option}"
                )
    assert found > 10


def test_the_page_of_verdicts_names_what_holds_each_row() -> None:
    text = (ROOT / "tests" / "verdicts.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \|.*\| ([^|]+) \|$", text, re.MULTILINE)
    assert [int(number) for number, _ in rows] == list(range(1, len(rows) + 1)) and len(rows) > 18
    assert all("`tests/" in held for _, held in rows)
