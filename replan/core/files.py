"""Checks files that users name before they are opened; lists, fetches and writes files at URLs.

Named pipes, which may never end, and deeply nested tables, which can exhaust the stack, are
refused.

A URL (`s3://`, `gs://`, and all others that fsspec supports) may replace a path. It may also be a
`Path`, which drops a slash ("s3:/bucket/key"). `file://` is a local path. Credentials come from the
environment as fsspec documents (AWS_ACCESS_KEY_ID, AWS_ENDPOINT_URL ...); they are never options,
and never stored in a file of a run.
"""

from __future__ import annotations

import re
import shutil
import stat
import tempfile
import tomllib
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from replan.core.errors import ConfigError, LogError, OutputError, ReplanError

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
# Not a Windows drive: one letter
_URL = re.compile(r"([a-z][a-z0-9+.-]+):/+(.*)", re.IGNORECASE | re.DOTALL)
_VERSIONS = ("ETag", "etag", "md5Hash", "LastModified", "last_modified", "mtime", "created")
"""Keys under which file systems state a version of the content, the most reliable first."""


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


@dataclass(frozen=True)
class RemoteFile:
    """A file at a URL."""

    url: str  # its URL
    name: str  # its path below the listed URL, with "/" between folders
    size: int  # size in bytes
    version: str  # text that changes with the content; "": unknown


def url_of(place: Path | str) -> str:
    """Return the URL of a path or URL; "" if it is a local path."""
    match = _URL.fullmatch(str(place).replace("\\", "/"))
    return (
        f"{match[1].lower()}://{match[2]}".rstrip("/")
        if match and match[1].lower() != "file"
        else ""
    )


def local_path(place: Path | str) -> Path:
    """Return the local path of a path or of `file:///...`."""
    match = _URL.fullmatch(str(place))
    return Path(f"/{match[2]}") if match and match[1].lower() == "file" else Path(place)


def on_this_machine(place: Path | str) -> Path:
    """Return the local path to which a command writes; ConfigError if it is a URL."""
    if url := url_of(place):
        reason = "only `replan evaluate` and `replan merge` write to a URL"
        raise ConfigError(f"{url}: {reason}; give a path on this machine, and copy it there")
    path = local_path(place)
    if not is_utf8(path):
        raise ConfigError(f"{path}: {NOT_UTF8}; give another name")
    return path


def listed(url: str) -> tuple[RemoteFile, ...]:
    """Return the file at a URL, or all files under it, sorted, or none; ConfigError if it cannot be
    listed.
    """
    with _remote(url, ConfigError) as (system, path):
        system.invalidate_cache()
        entries: dict[str, Any] = system.find(path, detail=True)
    base = path.rstrip("/")
    files = []
    for key, info in sorted(entries.items()):
        name = key.removeprefix(base).lstrip("/") or Path(base).name
        if ".." in name.split("/"):
            raise ConfigError(
                f"{url}/{name}: has '..' in its name, which would lead out of a folder; rename it"
            )
        version = next((str(info[word]).strip('"') for word in _VERSIONS if info.get(word)), "")
        files.append(
            RemoteFile(
                url if key == base else f"{url}/{name}", name, int(info.get("size") or 0), version
            )
        )
    return tuple(file for file in files if not file.url.endswith("/"))


def heads(files: Sequence[RemoteFile], size: int) -> list[bytes]:
    """Return the first `size` bytes of each file, fetched together; ConfigError if a file cannot be
    fetched.
    """
    if not files:
        return []
    with _remote(files[0].url, ConfigError) as (system, _):
        ends = [min(size, file.size) for file in files]
        fetched: list[bytes | Exception] = system.cat_ranges(
            [system._strip_protocol(file.url) for file in files], [0] * len(ends), ends
        )
    contents = []
    for file, head in zip(files, fetched, strict=True):
        with _remote(file.url, ConfigError):
            if isinstance(head, Exception):
                raise head
            contents.append(head)
    return contents


def fetch(files: Sequence[RemoteFile], folder: Path) -> None:
    """Copy files under their names into a folder; LogError if one is gone or has changed, or the
    disk is full.
    """
    need, free = sum(file.size for file in files), shutil.disk_usage(folder).free
    if need > free:
        problem = (
            f"{need / 1e6:.0f} MB have to be fetched, {free / 1e6:.0f} MB are free in "
            f"{folder.parent}"
        )
        raise LogError(
            problem, file=files[0].url, remedy="set TMPDIR to a folder with enough free space"
        )
    for file in files:
        target = folder / file.name
        target.parent.mkdir(parents=True, exist_ok=True)
        with _remote(file.url, LogError) as (system, path):
            system.get_file(path, str(target))
        if target.stat().st_size != file.size:
            raise LogError(
                "has changed since it was listed", file=file.url, remedy="evaluate again"
            )


def ranged(file: RemoteFile) -> Callable[[int, int], bytes]:
    """Return a function that fetches the bytes of a file between two offsets.

    It raises LogError if it fails.
    """

    def fetched(begin: int, end: int) -> bytes:
        with _remote(file.url, LogError) as (system, path):
            part: bytes = system.cat_file(path, start=begin, end=end)
            return part

    return fetched


def put(content: Path, url: str) -> None:
    """Copy a local file to a URL; OutputError if it cannot be written."""
    with _remote(url, OutputError) as (system, path):
        system.put_file(str(content), path)


def put_new(content: bytes, url: str) -> bool:
    """Write bytes to a URL unless a file exists; return whether it wrote.

    ConfigError if the write fails.
    """
    with _remote(url, ConfigError) as (system, path):
        try:
            system.pipe_file(path, content, mode="create")
        except FileExistsError:
            return False
        return True


def content(url: str) -> bytes:
    """Return the content of the file at a URL; ConfigError if it cannot be read."""
    with _remote(url, ConfigError) as (system, path):
        whole: bytes = system.cat_file(path)
        return whole


def remove(urls: Sequence[str]) -> None:
    """Remove files; OutputError if one cannot be removed."""
    for url in urls:
        with _remote(url, OutputError) as (system, path):
            system.rm_file(path)


class Near:
    """A local `path` for a `place`, a path or URL; the local copy of a URL is removed together with
    this object.

    Of a folder, files with the suffixes `but` (".rrd") are not copied.

    Raises:
        ConfigError: Nothing exists at the URL, or it cannot be listed.
        LogError: A file cannot be fetched.
    """

    def __init__(self, place: Path | str, but: tuple[str, ...] = ()) -> None:
        url, self.path = url_of(place), local_path(place)
        self.place = url or str(self.path)
        self._remove: Callable[[], object] | None = None
        if not url:
            return
        files = listed(url)
        if not files:
            raise ConfigError(f"{url}: no file exists at this URL")
        scratch = tempfile.mkdtemp(prefix="replan-")
        self._remove = weakref.finalize(self, shutil.rmtree, scratch, ignore_errors=True)
        self.path = Path(scratch, Path(url).name)
        if files[0].url == url:
            fetch(files, self.path.parent)
        else:
            self.path.mkdir()
            fetch([file for file in files if not file.name.endswith(but)], self.path)

    def close(self) -> None:
        """Remove the copy now."""
        if self._remove is not None:
            self._remove()


@contextmanager
def here(place: Path | str) -> Iterator[Path]:
    """`Near.path` within a `with` block."""
    with closing(Near(place)) as near:
        yield near.path


@contextmanager
def _remote(url: str, kind: type[ReplanError]) -> Iterator[tuple[Any, str]]:
    """The file system of a URL, and the path in it.

    Any error of its library becomes a one-line one of class `kind`.
    """
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise ConfigError(f"{url}: URLs need fsspec: pip install 'replan[s3]'") from None
    try:
        system, path = url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise ConfigError(f"{url}: {error}; of S3: pip install 'replan[s3]'") from None
    try:
        yield system, str(path)
    except (ReplanError, FileExistsError):
        raise
    except FileNotFoundError:
        raise kind(f"{url}: not there; look at bucket and key") from None
    except Exception as error:
        # Those of botocore
        if isinstance(error, PermissionError) or "Credentials" in type(error).__name__:
            hint = (
                "set what fsspec documents for it in the environment (S3: AWS_ACCESS_KEY_ID, "
                "AWS_PROFILE)"
            )
            raise kind(f"{url}: no permission: {error}; {hint}") from None
        problem = " ".join(str(error).split())[:200]
        raise kind(
            f"{url}: no connection or an error there: {type(error).__name__}: {problem}; try again"
        ) from None
