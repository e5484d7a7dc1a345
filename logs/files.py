"""Files that users name, checked before they are opened: pipes never end, and nested tables can exhaust the stack."""

from __future__ import annotations

import re
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from logs.errors import ConfigError, LogError

LARGEST_TOML_BYTES = 1 << 20
"""Limit of a configuration or file of gates: the largest in use have some 10 KiB."""
DEEPEST_TOML = 16
"""Limit of nested tables and lists: no key that replan reads is deeper than 5."""
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY = re.compile(rf"(?<![\w-])(?:{_PART}\.[ \t]*+){{{DEEPEST_TOML}}}")
"""A dotted key of more parts: `tomllib` takes seconds for 20,000 of them, with the square of their number."""
SPECIAL = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
WRITE_A_FILE = "write its content to a file and name that"


def special_kind(path: Path) -> str:
    """What a path is if it is neither a file nor a folder ("a named pipe"); "" for those and where nothing is."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return "a link that leads nowhere" if path.is_symlink() else ""
    return next((name for test, name in SPECIAL if test(mode)), "")


def check_regular(*paths: Path) -> None:
    """Refuse pipes, sockets and devices, which may block or never end, and broken links: LogError with the kind."""
    for path in paths:
        kind = special_kind(path)
        if kind:
            raise LogError(f"is {kind}, not a file", file=path, remedy=WRITE_A_FILE)


def check_named(path: Path) -> None:
    """`check_regular` for a file that an option names: ConfigError."""
    kind = special_kind(path)
    if kind:
        raise ConfigError(f"{path}: is {kind}, not a file; {WRITE_A_FILE}")


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ConfigError: There is no such file, it cannot be read, is not TOML, too large or nested too deeply.
    """
    try:
        check_named(path)
        size = path.stat().st_size
        if size > LARGEST_TOML_BYTES:
            raise ConfigError(f"{path}: has {size} bytes, at most {LARGEST_TOML_BYTES} are read; shorten it")
        text = path.read_text(encoding="utf-8")
        if _LONG_KEY.search(text):
            raise _too_deep(path)
        table = tomllib.loads(text)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None
    except RecursionError:
        raise _too_deep(path) from None
    if any(depth > DEEPEST_TOML for depth in _depths(table)):
        raise _too_deep(path)
    return table


def _too_deep(path: Path) -> ConfigError:
    return ConfigError(f"{path}: tables or lists nested deeper than {DEEPEST_TOML}; nest them less")


def _depths(table: dict[str, Any]) -> Iterator[int]:
    """The depth of every table and list in a table, without recursion."""
    left: list[tuple[Any, int]] = [(table, 0)]
    while left:
        value, depth = left.pop()
        yield depth
        if depth <= DEEPEST_TOML:
            inner = value.values() if isinstance(value, dict) else value
            left += [(each, depth + 1) for each in inner if isinstance(each, dict | list)]
