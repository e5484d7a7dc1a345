"""Checks files that users name before they are opened, and reads TOML and XML.

Named pipes, which may never end, and deeply nested tables, which can exhaust the stack, are
refused.
"""

from __future__ import annotations

import re
import stat
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from replan.core.errors import ConfigError, LogError

LARGEST_TOML_BYTES = 1_048_576
"""Largest size of a configuration or gates file: the largest files in use have some 10 KiB."""
LARGEST_XML_BYTES = 1_073_741_824
"""Largest size of a map."""
DEEPEST_TOML = 16
"""Deepest nesting of tables and lists: no key that replan reads is deeper than 5."""
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY = re.compile(rf"(?<![\w-])(?:{_PART}\.[ \t]*+){{{DEEPEST_TOML}}}")
"""Matches a dotted key with more parts: `tomllib` takes quadratic time, seconds for 20,000
parts.
"""
SPECIAL = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
POINTER, MOST_POINTER_BYTES = b"version https://git-lfs.github.com/spec/", 1024
"""First bytes and largest size of a Git LFS pointer (its specification)."""
NOT_UTF8, RENAME = "its name is not UTF-8", "rename it"
WRITE_A_FILE = "write its content to a file and name that"


def is_utf8(path: Path) -> bool:
    """Return whether the bytes of a path are UTF-8, as the texts in all files of results are."""
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def special_kind(path: Path) -> str:
    """Return the kind of a path if it is no file or folder ("a named pipe"); "" otherwise, or if
    nothing exists.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return "a link that leads nowhere" if path.is_symlink() else ""
    return next((name for test, name in SPECIAL if test(mode)), "")


def beside(folder: Path, names: Sequence[str]) -> Path | None:
    """Return the optional file of a log's folder that has one of the `names`; None if there is
    none.

    Raises:
        LogError: The entry is not a file, several of the names exist, or a name differs from these
            by case only (its content would silently be left out).
    """
    try:
        entries = {entry.name for entry in folder.iterdir()}
    except OSError as error:
        raise LogError(f"the folder cannot be read: {error.strerror}", file=folder) from None
    present = [name for name in names if name in entries]
    by_folded_name = {name.casefold(): name for name in names}
    for name in sorted(entries - set(names)):
        if name.casefold() in by_folded_name:
            meant = by_folded_name[name.casefold()]
            problem = f"{name} is not read: the file's name is {meant}"
            raise LogError(problem, topic=name, remedy=f"rename it to {meant}")
    if len(present) > 1:
        raise LogError(
            f"{' and '.join(present)} are both there", topic=present[0], remedy="keep one of them"
        )
    if not present:
        return None
    path = folder / present[0]
    if not path.is_file():
        remedy = "put a file there, or remove it if there is none"
        raise LogError(
            f"{path.name} is {special_kind(path) or 'a folder'}, not a file",
            topic=path.name,
            remedy=remedy,
        )
    return path


def check_regular(*paths: Path) -> None:
    """Raise LogError for pipes, sockets and devices, which may block or never end, broken links,
    Git LFS pointers.
    """
    for path in paths:
        kind = special_kind(path)
        if kind:
            raise LogError(f"is {kind}, not a file", file=path, remedy=WRITE_A_FILE)
        if not is_utf8(path):
            raise LogError(NOT_UTF8, file=path, remedy=RENAME)
        if _is_pointer(path):
            raise LogError(
                "is a Git LFS pointer, not the file",
                file=path,
                remedy="fetch the file with `git lfs pull`",
            )


def _is_pointer(path: Path) -> bool:
    """Return whether a file stands for one that Git LFS has not fetched; False if it cannot be
    read.
    """
    try:
        if not path.is_file() or path.stat().st_size > MOST_POINTER_BYTES:
            return False
        with path.open("rb") as stream:
            return stream.read(len(POINTER)) == POINTER
    except OSError:
        return False


def refuse_doctype(target: object, name: str, public: str | None, system: str | None) -> None:
    """Refuse a document type declaration, in which entities could grow without bound: a method of a
    parser's target.
    """
    raise LogError(
        "it has a document type declaration, which maps do not need",
        remedy="remove the declaration",
    )


def read_xml(
    path: Path, what: str = "complete XML", target: Any = None, *, largest: int = LARGEST_XML_BYTES
) -> Any:
    """Parse an XML file in pieces; return its root element, or what the `target` of the parser
    returns.

    Raises:
        LogError: It cannot be read, has more than `largest` bytes, is not `what`, or has a document
            type declaration.
    """
    from xml.etree.ElementTree import ParseError, TreeBuilder, XMLParser

    class Tree(TreeBuilder):
        doctype = refuse_doctype

    parser = XMLParser(target=target or Tree())
    try:
        if path.stat().st_size > largest:
            raise LogError(f"larger than {largest >> 20} MiB", remedy="cut the map")
        with path.open("rb") as stream:
            while chunk := stream.read(1 << 16):
                parser.feed(chunk)
        return parser.close()
    except OSError as error:
        raise LogError(
            f"cannot be read: {error.strerror}", file=path, remedy="check the path"
        ) from error
    except (ParseError, ValueError, LookupError) as error:
        raise LogError(
            f"is no {what}: {error}", file=path, remedy="fetch the file again"
        ) from error
    except LogError as error:
        raise error.at(path) from None


def check_named(path: Path) -> None:
    """Check a file that an option names, as `check_regular` does, but raise ConfigError."""
    kind = special_kind(path)
    if kind:
        raise ConfigError(f"{path}: is {kind}, not a file; {WRITE_A_FILE}")
    if not is_utf8(path):
        raise ConfigError(f"{path}: {NOT_UTF8}; {RENAME}")


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; ConfigError if it cannot be read, is not TOML, too large or nested
    too deeply.
    """
    try:
        check_named(path)
        size = path.stat().st_size
        if size > LARGEST_TOML_BYTES:
            raise ConfigError(
                f"{path}: has {size} bytes, at most {LARGEST_TOML_BYTES} are read; shorten it"
            )
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
    except ValueError:  # by int(): its limit of digits
        raise ConfigError(f"{path}: has a number of thousands of digits; shorten it") from None
    except RecursionError:
        raise _too_deep(path) from None
    stack: list[tuple[Any, int]] = [(table, 0)]  # without recursion
    while stack:
        value, depth = stack.pop()
        if depth > DEEPEST_TOML:
            raise _too_deep(path)
        inner = value.values() if isinstance(value, dict) else value
        stack += [(item, depth + 1) for item in inner if isinstance(item, dict | list)]
    return table


def _too_deep(path: Path) -> ConfigError:
    return ConfigError(f"{path}: tables or lists nested deeper than {DEEPEST_TOML}; nest them less")
