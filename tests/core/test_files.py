"""What a user names is looked at before it is opened: pipes, devices, tables without end.

Files of a store.
"""

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import replan
from short_logs import short

from replan.core.errors import ConfigError, LogError
from replan.core.files import (
    DEEPEST_TOML,
    LARGEST_TOML_BYTES,
    check_named,
    check_regular,
    read_toml,
)
from replan.core.urls import heads, listed, on_this_machine
from replan.logs.mcap import read_scenario, write_scenario

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")


@pytest.fixture(autouse=True)
def deadline() -> Iterator[None]:
    """A pipe that is opened blocks for ever: SIGALRM ends the test then."""
    signal.alarm(120)
    yield
    signal.alarm(0)


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("inspect PIPE", 3),
        ("inspect PIPE.mcap", 3),
        ("inspect PIPE.csv", 3),
        ("evaluate PIPE -o OUT", 2),
        ("evaluate PIPE.mcap -o OUT", 2),
        ("convert PIPE.xml -o OUT.mcap", 3),
        ("evaluate LOG --config PIPE -o OUT", 2),
        ("evaluate LOG --gates PIPE -o OUT", 2),
        ("evaluate LOG --map PIPE -o OUT", 2),
        ("evaluate LOG --baseline PIPE -o OUT", 2),
        ("inspect LOG --map PIPE", 3),
        ("view PIPE", 2),
        ("compare PIPE PIPE", 2),
        ("salvage PIPE OUT.mcap", 2),
    ],
)
def test_a_pipe_in_place_of_a_file_is_refused_in_one_line(
    pipe: Path, words: str, code: int
) -> None:
    for suffix in (".mcap", ".csv", ".xml"):
        os.mkfifo(f"{pipe}{suffix}")
    write_scenario(pipe.parent / "log.mcap", short("test/log"))
    places = {
        "PIPE": str(pipe),
        "OUT": str(pipe.parent / "out"),
        "LOG": str(pipe.parent / "log.mcap"),
    }
    for name, place in places.items():
        words = words.replace(name, place)
    done = replan(*words.split())
    assert done.exit_code == code, done.output
    (line,) = (line for line in done.output.splitlines() if "error: " in line)
    assert str(pipe) in line and ("is a named pipe, not a file" in line or "no such" in line)


def test_sockets_and_devices_are_refused_and_files_and_folders_are_not(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "s"))
        with pytest.raises(LogError, match="is a socket, not a file; write its content to a file"):
            check_regular(tmp_path / "s")
    with pytest.raises(LogError, match="is a device"):
        check_regular(Path("/dev/zero"))
    with pytest.raises(ConfigError, match="is a device"):
        read_toml(Path("/dev/zero"))


def test_names_that_are_not_utf8_are_refused(tmp_path: Path) -> None:
    log = tmp_path / os.fsdecode(b"drive\xff.csv")
    try:
        log.touch()
    except OSError:
        pytest.skip("the file system has only UTF-8 names")
    with pytest.raises(LogError, match=r"drive\\udcff\.csv: its name is not UTF-8; rename it"):
        check_regular(log)
    for function in (check_named, on_this_machine):
        with pytest.raises(ConfigError, match="its name is not UTF-8"):
            function(log)


def test_a_log_with_a_name_that_is_not_utf8_fails_alone(tmp_path: Path) -> None:
    for name, speed in ((b"a.mcap", 6.0), (b"b\xff.mcap", 7.0)):
        write_scenario(tmp_path / "a.mcap", short("test/a", v=speed))
        try:
            (tmp_path / "a.mcap").rename(tmp_path / os.fsdecode(b"logs-" + name))
        except OSError:
            pytest.skip("the file system has only UTF-8 names")
    options = ("-p", "constant_speed", "--mode", "open", "--workers", "0", "--no-recording")
    done = replan("evaluate", *tmp_path.glob("logs-*"), *options, "-o", tmp_path / "out")
    assert done.exit_code == 3, done.output
    assert "logs-b\\udcff.mcap: its name is not UTF-8; rename it" in done.output.replace("\n", "")
    assert (tmp_path / "out" / "report.html").exists()


def test_an_integer_of_thousands_of_digits_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text("seed = " + "1" * 100_000)
    with pytest.raises(ConfigError, match=r"run\.toml: has a number of thousands of digits"):
        read_toml(path)
    check_regular(tmp_path, Path(__file__), tmp_path / "nothing")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a = " + 20_000 * "[" + 20_000 * "]", f"nested deeper than {DEEPEST_TOML}"),
        ("a = " + 20_000 * "{a=" + "1" + 20_000 * "}", f"nested deeper than {DEEPEST_TOML}"),
        (".".join(["a"] * 20_000) + " = 1", f"nested deeper than {DEEPEST_TOML}"),
        ("[planner.x]\na = " + 200 * "[" + 200 * "]", f"nested deeper than {DEEPEST_TOML}"),
        (
            "#" * (LARGEST_TOML_BYTES + 1),
            f"has {LARGEST_TOML_BYTES + 1} bytes, at most {LARGEST_TOML_BYTES}",
        ),
    ],
    ids=["lists", "tables", "dotted", "planner", "large"],
)
@pytest.mark.parametrize("option", ["--config", "--gates"])
def test_a_table_that_is_nested_or_too_large_costs_one_line(
    tmp_path: Path, text: str, what: str, option: str
) -> None:
    file = tmp_path / "deep.toml"
    file.write_text(text)
    done = replan("evaluate", option, file, "-o", tmp_path / "out")
    assert done.exit_code == 2 and done.stderr.count("\n") == 1, done
    assert str(file) in done.stderr and what in done.stderr


def test_the_table_that_a_run_writes_is_within_the_limits(tmp_path: Path) -> None:
    deepest = "[a" + ".b" * (DEEPEST_TOML - 1) + "]\n"
    (tmp_path / "run.toml").write_text(deepest)
    assert read_toml(tmp_path / "run.toml")


def test_json_nested_without_end_in_a_log_costs_one_line(tmp_path: Path) -> None:
    from mcap.writer import Writer

    from replan.logs.mcap import native

    with (tmp_path / "deep.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        notes = 50_000 * "[" + 50_000 * "]"
        writer.add_metadata(native.SCENARIO_RECORD, {"format_version": "1", "notes": notes})
        schema = writer.register_schema("replan.EgoState", "jsonschema", b"{}")
        channel = writer.register_channel("/ego", "json", schema)
        writer.add_message(channel, 0, notes.encode(), 0)
        writer.finish()
    with pytest.raises(LogError) as caught:
        read_scenario(tmp_path / "deep.mcap")
    assert len(str(caught.value)) < 1000


@pytest.fixture
def store() -> Iterator[Any]:
    fsspec = pytest.importorskip(
        "fsspec", reason="the extra s3 is not installed: pip install 'replan[s3]'"
    )
    system = fsspec.filesystem("memory")
    yield system
    system.store.clear()


def test_a_begin_that_cannot_be_read_is_one_line_that_names_it(store: Any) -> None:
    store.pipe({"/fleet/a.mcap": b"abc", "/fleet/b.mcap": b"defg"})
    files = listed("memory://fleet")
    assert heads(files, 2) == [b"ab", b"de"]
    store.rm("/fleet/b.mcap")
    with pytest.raises(ConfigError, match=r"^memory://fleet/b.mcap: not there"):
        heads(files, 2)


def test_a_name_that_leads_out_of_its_folder_is_refused(store: Any) -> None:
    store.pipe("/fleet/a/../../evil.mcap", b"abc")
    with pytest.raises(ConfigError, match=r"a/../../evil.mcap: has '..' in its name"):
        listed("memory://fleet")
