"""A result folder at a URL: a folder of this machine while the run lasts, from which each log's folder goes there.

What is there at any time is what an interrupted run would have left: `run.toml`, and the folders of the logs that are
finished, each with its card `log.json` written last; a folder without card is not whole and is not taken. Tables and
reports follow at the end. `--resume` fetches what is there first. What an earlier run left there goes as the first log
is sent: a run that cannot begin (a name is wrong, a log is not there) removes nothing.

One run at a time: the object `.lock` is written only where there is none, which S3 (conditional writes) and Google's
store do in one step. No object store ends a lock with its holder: that of a process of this machine that has ended is
taken over, that of another machine is named, and removed by hand.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from logs.errors import ConfigError, ReplanError
from logs.files import content, fetch, listed, local_path, put, put_new, remove, url_of
from replay.results.log_result import LogResult
from replay.results.tables import FILES, LOCK, LOG_CARD, PARTIAL
from replay.run.lock import card, has_ended
from replay.run.sources import LogSource


@dataclass
class OutputLocation:
    """Where the results of a run are written.

    Attributes:
        folder: On this machine; None: the next free one.
        url: Where it goes from there; "": nowhere.
        there: When each file was written that is at the URL and need not go there again unless it is written anew.
        old: What is at the URL and goes before anything is sent.
    """

    folder: Path | None
    url: str = ""
    there: dict[str, int] = field(default_factory=dict)
    old: list[str] = field(default_factory=list)

    def check_outside(self, sources: Sequence[LogSource]) -> None:
        """ConfigError where the URL holds a log that is to be driven: it would be removed."""
        urls = [file.url for source in sources for file in source.remote]
        inside = [url for url in urls if self.url and url.startswith(f"{self.url}/")]
        if inside:
            where = f"lies in the results {self.url}, which are replaced"
            raise ConfigError(f"{inside[0]}: {where}; give --out another place")

    def keep(self, result: LogResult) -> None:
        """Send a log's folder, and before the first `run.toml`; OutputError."""
        if self.url and self.folder is not None and result.folder:
            files = sorted((self.folder / result.folder).iterdir(), key=lambda path: (path.name == LOG_CARD, path.name))
            self._send([self.folder / "run.toml", *files])

    def finish(self) -> None:
        """Send all that is not there yet; OutputError."""
        if self.url and self.folder is not None:
            files = (path for path in sorted(self.folder.rglob("*")) if path.is_file() and path.name != LOCK)
            self._send([path for path in files if not path.relative_to(self.folder).parts[0].startswith(PARTIAL)])

    def _send(self, files: Sequence[Path]) -> None:
        assert self.folder is not None
        remove(self.old)
        self.old = []
        for path in files:
            name, written = path.relative_to(self.folder).as_posix(), path.stat().st_mtime_ns
            if self.there.get(name) != written:
                put(path, f"{self.url}/{name}")
                self.there[name] = written


@contextmanager
def output_location(out: Path | str | None, *, resume: bool = False) -> Iterator[OutputLocation]:
    """A place for a run's results; at a URL it is held, and what is there is fetched (`resume`) or replaced.

    Raises:
        ConfigError: Another run writes there, it holds something else than results, or it cannot be written.
        OutputError: The connection is lost; finished logs are there for `resume`.
    """
    url = "" if out is None else url_of(out)
    if not url:
        yield OutputLocation(None if out is None else local_path(out))
        return
    _hold(url)
    try:
        with tempfile.TemporaryDirectory(prefix="replan-") as scratch:
            folder = Path(scratch, "results")
            place = _begun(url, folder, resume=resume)
            try:
                yield place
                place.finish()
            except (ReplanError, KeyboardInterrupt) as error:
                raise type(error)(str(error).replace(str(folder), url)) from error
    finally:
        remove([f"{url}/{LOCK}"])


def _begun(url: str, folder: Path, *, resume: bool) -> OutputLocation:
    """The place, with what stays of the results that are there."""
    files = [file for file in listed(url) if file.name != LOCK]
    cards = {file.name.partition("/")[0] for file in files if file.name.endswith(f"/{LOG_CARD}")}
    logs = [file for file in files if "/" in file.name]
    foreign = [file for file in files if "/" not in file.name and file.name not in FILES]
    if not any(file.name == "run.toml" for file in files):
        foreign += files
    if foreign:
        raise ConfigError(f"{url}: contains {foreign[0].name}, not a replan result; give --out a new or empty place")
    whole = [file for file in logs if file.name.partition("/")[0] in cards] if resume else []
    kept = [*whole, *(file for file in files if resume and file.name == "run.toml")]
    if kept:
        folder.mkdir()
        fetch(kept, folder)
    there = {file.name: (folder / file.name).stat().st_mtime_ns for file in kept}
    # removed first are the cards, so that no folder looks whole that is not, and last run.toml, which says whose it is
    order = sorted(files, key=lambda file: (file.name == "run.toml", not file.name.endswith(LOG_CARD), file.name))
    return OutputLocation(folder, url, there, [file.url for file in order if file not in kept])


def _hold(url: str) -> None:
    """Write the lock; ConfigError where another run has it."""
    lock = f"{url}/{LOCK}"
    while not put_new(card(), lock):
        try:
            holder = dict(json.loads(content(lock)))
        except ValueError:
            holder = {}
        if not has_ended(holder):
            who = f"process {holder.get('pid')} on {holder.get('host')} since {holder.get('since')}"
            remedy = f"wait for it, or give --out another place; if it has ended, remove {lock}"
            raise ConfigError(f"{url}: another run writes into it ({who}); {remedy}")
        remove([lock])
