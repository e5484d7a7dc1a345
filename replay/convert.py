"""`replan convert`: logs of any format to native MCAP, and the list of formats."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from logs.errors import ConfigError, LogError
from logs.mcap import write_scenario
from logs.mcap.writer import Entry
from logs.readers import GROUP, LogSettings, Reader, logs_in, read_log, reader_called, reader_of, readers
from logs.scenario import Scenario


def listing() -> Iterator[str]:
    """The formats, a line each, and how one is added."""
    width = max(len(reader.name) for reader in readers())
    for reader in readers():
        keys = f"; [log] {', '.join(reader.settings)}" if reader.settings else ""
        yield f"{reader.name:{width}}  {reader.summary} ({reader.looks_for}{keys})"
    yield f"Yours: a logs.readers.Reader, named by an entry point of the group {GROUP}; see logs/readers/base.py."


def convert_all(
    logs: Sequence[Path],
    out: Path,
    settings: LogSettings,
    *,
    foxglove: bool = False,
    say: Callable[[str], None],
    say_error: Callable[[str], None],
) -> bool:
    """Write logs as native MCAP: into `out` if that is named .mcap, else into that folder; whether all could be read.

    With `foxglove` they get channels that Foxglove draws.
    A first name that is no path and a reader's asks for that reader: it takes the files whatever their names are.

    Raises:
        ConfigError: Several logs are to go into one file, there is nothing to convert, or what Foxglove needs is not
            installed.
    """
    reader = None
    if not logs[0].exists() and str(logs[0]) in {each.name for each in readers()}:
        reader, logs = reader_called(str(logs[0])), logs[1:]
    found = [log for path in logs for log in _logs_at(path)]
    if not found:
        raise ConfigError("no logs to convert; `replan convert --formats` lists what replan reads")
    single = out.suffix == ".mcap"
    if single and len(found) > 1:
        raise ConfigError(f"{len(found)} logs do not go into one log: give a folder with -o")
    channels = _channels(foxglove)
    done = [
        _converted(log, out if single else out / _name(log), settings, reader, channels, say, say_error)
        for log in found
    ]
    return all(done)


def _channels(foxglove: bool) -> Callable[[Scenario], Iterable[Entry]]:
    """What is written beside a scenario."""
    if not foxglove:
        return lambda scenario: ()
    from replay.foxglove import scenario_channels

    return scenario_channels


def _logs_at(path: Path) -> Iterator[Path]:
    if path.is_dir() and reader_of(path) is None:
        yield from (log for log, reader in logs_in(path) if reader is not None)
    else:
        yield path


def _name(log: Path) -> str:
    return f"{log.name if log.is_dir() else log.stem.removesuffix('.cr')}.mcap"


def _converted(
    log: Path,
    target: Path,
    settings: LogSettings,
    reader: Reader | None,
    channels: Callable[[Scenario], Iterable[Entry]],
    say: Callable[[str], None],
    say_error: Callable[[str], None],
) -> bool:
    try:
        scenario = read_log(log, settings, reader)
        target.parent.mkdir(parents=True, exist_ok=True)
        write_scenario(target, scenario, beside=channels(scenario))
    except LogError as error:
        say_error(str(error))
        return False
    say("\n".join([str(target), *(f"    note: {note}" for note in scenario.notes)]))
    return True
