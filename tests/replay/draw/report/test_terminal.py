"""What a log calls itself reaches no terminal raw, and what a terminal's encoding lacks is no traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table
from rich.text import Text
from short_logs import short
from typer.testing import CliRunner

from logs.mcap import write_scenario
from replay.cli import app
from replay.draw.report.console import SafeConsole, visible, wrapped

EVIL = "\x1b[2J\x1b]0;title\x07\r\x9b31mpaper/\u202egnp\x7f"
RAW = ("\x1b[2J", "\x1b]0", "\x07", "\r", "\x9b", "\u202e", "\x7f")


@given(text=st.text())
def test_nothing_invisible_is_left_and_nothing_else_is_changed(text: str) -> None:
    seen = visible(text)
    assert len(seen) == len(text) and visible(seen) == seen
    assert not any((ord(c) < 32 and c not in "\n\t") or 0x7F <= ord(c) < 0xA0 for c in seen)
    assert all(a == b for a, b in zip(text, seen, strict=True) if a.isprintable())


@given(words=st.lists(st.text("ab-", min_size=1, max_size=9), max_size=30), indent=st.integers(0, 6))
def test_a_wrapped_line_has_the_same_words_and_fits(words: list[str], indent: int) -> None:
    lines = wrapped(" " * indent + " ".join(words), 20).split("\n")
    assert " ".join(lines).split() == words and all(len(line) <= 20 for line in lines)
    assert all(line.startswith(" " * (indent + 2)) for line in lines[1:])


@pytest.mark.parametrize("colour", [True, False])
def test_a_console_styles_its_own_words_alone(colour: bool) -> None:
    written = StringIO()
    table = Table("log")
    table.add_row(Text(EVIL, style="red"))
    console = SafeConsole(file=written, width=100, force_terminal=colour, color_system="standard" if colour else None)
    console.print(table, EVIL)
    shown = written.getvalue()
    assert ("\x1b[31m" in shown) == colour
    assert not any(raw in shown for raw in RAW)
    assert "\u241b[2J" in shown


def test_no_command_lets_a_name_through(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", replace(short("x"), name=EVIL))
    evaluate = ["evaluate", str(tmp_path / "log.mcap"), "-p", "constant_speed", "--workers", "0", "--no-recording"]
    for words in (
        ["inspect", str(tmp_path / "log.mcap")],
        ["inspect", str(tmp_path / EVIL.replace("/", ""))],
        [*evaluate, "-v", "-o", str(tmp_path / "out")],
        ["compare", str(tmp_path / "out"), str(tmp_path / "out")],
    ):
        done = CliRunner().invoke(app, words, color=True)
        assert not any(raw in done.output for raw in RAW)


@pytest.mark.slow
def test_an_encoding_that_lacks_a_letter_is_no_traceback(tmp_path: Path) -> None:
    write_scenario(tmp_path / "北.mcap", short("x"))
    path = os.pathsep.join([str(Path.cwd()), *sys.path])
    environment = {**os.environ, "PYTHONIOENCODING": "latin-1", "PYTHONPATH": path, "PYTHONUTF8": "1"}
    command = [sys.executable, "-c", "from replay.cli import main; main()", "inspect", "北.mcap"]
    for more, said in (([], b"?.mcap"), (["--json"], b"\\u5317.mcap")):
        done = subprocess.run([*command, *more], env=environment, cwd=tmp_path, capture_output=True, check=False)
        assert done.returncode == 0 and b"Traceback" not in done.stderr
        assert said in done.stdout
