"""The contract of readers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from os.path import commonpath
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from replan.contract.breaches import Findings, call, difference
from replan.core.errors import ConfigError, LogError, raised
from replan.core.urls import local_path
from replan.logs.readers import READER, LogSettings, Reader, read_log
from replan.logs.scenario import Scenario

READER_RULES: Mapping[str, str] = {
    "claims": "claim the logs of the format and no other path, and raise nothing",
    "files": "name the files of the log, in a fixed order",
    "contents": "return an empty LogContents where the topics cannot be read",
    "read": "return a Scenario",
    "admitted": "return what `replan.read_log` accepts",
    "same": "read equal scenarios from equal bytes",
    "damaged": "raise LogError for a log that cannot be read, and nothing else",
    "beside": "write nothing",
}
"""The rules for readers: what a breach of each means, by the rule's name."""

MOST_DAMAGED = 8
"""Of a log of many files, the largest number of those that are damaged in turn."""


def check_reader(
    reader: Reader | str, path: Path | str, settings: LogSettings | None = None
) -> None:
    """Check the contract of a reader on a log of its format, and on damaged copies of it.

    The rules are those of `replan.contract.READER_RULES`.

    Args:
        reader: The reader, its name, or "module:READER".
        path: A log that it reads; it is not changed.
        settings: The settings to read it with.

    Raises:
        ContractError: A rule is broken.
        ConfigError: The reader cannot be loaded.
        LogError: There is no such log.
    """
    reader = READER.find(reader) if isinstance(reader, str) else reader
    path, settings, findings = local_path(path), settings or LogSettings(), Findings(READER_RULES)
    beside = _entries(path)
    claimed = call(findings, "claims", path.name, reader.claims, path)
    if claimed is False:
        claimed = call(findings, "claims", path.name, reader.claims_with, path, settings)
        if claimed is False:
            findings.add("claims", path.name, "it does not claim the log")
    files = call(findings, "files", path.name, reader.files, path) or ()
    again = call(findings, "files", path.name, reader.files, path) or ()
    if not files or not all(file.is_file() for file in files) or again != files:
        findings.add(
            "files",
            path.name,
            f"its {len(files)} files do not all exist, or differ when asked again",
        )
        files = ()
    call(findings, "contents", path.name, reader.contents, path)
    _check_read(reader, path, settings, findings)
    with TemporaryDirectory() as folder:
        _check_foreign(reader, Path(folder), findings)
    for file in files[:: max(1, ceil(len(files) / MOST_DAMAGED))]:
        for share in (0.0, 0.5):
            with TemporaryDirectory() as folder:
                _check_damaged(
                    reader,
                    _damaged(path, files, file, share, Path(folder)),
                    share,
                    settings,
                    findings,
                )
    changed = sorted({name for name, _ in beside ^ _entries(path)})
    if changed:
        findings.add("beside", path.name, f"it wrote {changed[0]}")
    findings.report(f"reader {reader.name}")


def _check_read(reader: Reader, path: Path, settings: LogSettings, findings: Findings) -> None:
    with np.errstate(all="ignore"):  # as `read_log`
        scenario = call(findings, "read", path.name, reader.read, path, settings)
        if scenario is None or not isinstance(scenario, Scenario):
            findings.add("read", path.name, f"it returned {type(scenario).__name__}")
            return
        differs = difference(
            scenario, call(findings, "same", path.name, reader.read, path, settings)
        )
    if differs:
        findings.add("same", path.name, f"read twice, it differs in {differs}")
    call(findings, "admitted", path.name, lambda: read_log(path, settings, reader))


def _check_foreign(reader: Reader, folder: Path, findings: Findings) -> None:
    """Check that it claims no path of another kind."""
    (folder / "notes.of-no-format").write_bytes(b"no log\n")
    (folder / "empty").mkdir()
    for name in ("notes.of-no-format", "empty", "missing.of-no-format"):
        if call(findings, "claims", name, reader.claims, folder / name):
            findings.add("claims", name, "it claims a path that is no log of its format")


def _damaged(path: Path, files: Sequence[Path], file: Path, share: float, folder: Path) -> Path:
    """Copy a log into a folder, with only the first `share` of the bytes of one of its files.

    Return the copy.
    """
    root = Path(commonpath([path.parent, *(log_file.parent for log_file in files)]))
    for log_file in files:
        copy = folder / log_file.relative_to(root)
        copy.parent.mkdir(parents=True, exist_ok=True)
        content = log_file.read_bytes()
        copy.write_bytes(content[: int(share * len(content))] if log_file == file else content)
    return folder / path.relative_to(root)


def _check_damaged(
    reader: Reader, path: Path, share: float, settings: LogSettings, findings: Findings
) -> None:
    """Check what is raised for a damaged copy of the log, and that nothing is written beside it."""
    where, before = f"{path.name} with {share:.0%} of a file", _entries(path)
    call(findings, "claims", where, reader.claims, path)
    call(findings, "contents", where, reader.contents, path)
    try:
        with np.errstate(all="ignore"):
            reader.read(path, settings)
    except (LogError, ConfigError):
        pass
    except (Exception, SystemExit) as error:
        findings.add("damaged", where, f"it raised {raised(error, of=reader.read)}")
    else:
        if share == 0.0 and path.is_file():
            findings.add("damaged", where, "it read a drive from an empty file")
    if before != _entries(path):
        findings.add("beside", where, "it wrote a file")


def _entries(path: Path) -> set[tuple[str, int]]:
    within = path.rglob("*") if path.is_dir() else ()
    return {
        (str(entry), entry.stat().st_size)
        for entry in (*path.parent.iterdir(), *within)
        if entry.is_file()
    }
