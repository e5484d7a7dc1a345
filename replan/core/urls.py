"""Lists, fetches and writes files at URLs.

A URL (`s3://`, `gs://`, and all others that fsspec supports) may replace a path. It may also be a
`Path`, which drops a slash ("s3:/bucket/key"). `file://` is a local path. Credentials come from the
environment as fsspec documents (AWS_ACCESS_KEY_ID, AWS_ENDPOINT_URL ...); they are never options,
and never stored in a file of a run.
"""

from __future__ import annotations

import re
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from replan.core.errors import ConfigError, LogError, OutputError, ReplanError
from replan.core.files import NOT_UTF8, is_utf8

# Not a Windows drive: one letter
_URL = re.compile(r"([a-z][a-z0-9+.-]+):/+(.*)", re.IGNORECASE | re.DOTALL)
_VERSIONS = ("ETag", "etag", "md5Hash", "LastModified", "last_modified", "mtime", "created")
"""Keys under which file systems state a version of the content, the most reliable first."""


@dataclass(frozen=True)
class RemoteFile:
    """A file at a URL.

    Attributes:
        url: Its URL.
        name: Its path below the listed URL, with "/" between folders.
        size: Bytes.
        version: A text that changes with the content; "": unknown.
    """

    url: str
    name: str
    size: int
    version: str


def url_of(place: Path | str) -> str:
    """Return the URL of a path or URL; "" if it is a local path."""
    match = _URL.fullmatch(str(place).replace("\\", "/"))
    if match is None or match[1].lower() == "file":
        return ""
    return f"{match[1].lower()}://{match[2]}".rstrip("/")


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
        place = url if key == base else f"{url}/{name}"
        version = next((str(info[word]).strip('"') for word in _VERSIONS if info.get(word)), "")
        if not place.endswith("/"):
            files.append(RemoteFile(place, name, int(info.get("size") or 0), version))
    return tuple(files)


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
        raise LogError(
            f"{need / 1e6:.0f} MB have to be fetched, {free / 1e6:.0f} MB are free in "
            f"{folder.parent}",
            file=files[0].url,
            remedy="set TMPDIR to a folder with enough free space",
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
