"""`replan convert | repair | export`: logs of any format to native MCAP, the table of repairs,
CommonRoad solutions.

CommonRoad solution: the ego's states at the scenario's time steps, of the kinematic single track
model KS, in which the position is the centre of gravity, b behind it the rear axle
(commonroad-vehicle-models):

(1) p = r + b (cos yaw, sin yaw),   b = wheelbase - cog_to_front,   r the rear axle in the world
(2) A drive that reaches the goal between two steps is extended to the next one
        with the last acceleration and
    steering angle: s = v h + a h^2 / 2, yaw' = yaw + s tan(steer) / wheelbase

CommonRoad's checker integrates the model between the states: it accepts what such a vehicle drove,
so the drive must be one of `--vehicle kinematic_bicycle` with the numbers of one of CommonRoad's
vehicles.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import astuple, fields, replace
from io import StringIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from replan.core.errors import ConfigError, LogError
from replan.draw.drawn_results import load
from replan.logs.mcap import is_written_here, read_scenario, write_scenario
from replan.logs.mcap.writer import Entry
from replan.logs.readers import (
    READER,
    LogSettings,
    Reader,
    logs_in,
    read_log,
    reader_called,
    reader_of,
    readers,
)
from replan.logs.repair.detections import TrackChange
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, Trajectory
from replan.logs.trace import EndReason
from replan.logs.vehicle import vehicle_parameters
from replan.results.tables import csv_cell, safe_names, write_text
from replan.run.claim import claimed_file, claimed_files

CHANGE_COLUMNS = tuple(
    {"begin": "t_from_s", "end": "t_to_s"}.get(column.name, column.name)
    for column in fields(TrackChange)
)
"""Columns of the table: the fields of `replan.logs.repair.detections.TrackChange`."""
CHANGES_HEADER = ",".join(CHANGE_COLUMNS) + "\n"


def _has_changes(file: Path) -> bool:
    with file.open(encoding="utf-8") as stream:
        return stream.readline() == CHANGES_HEADER


def listing() -> Iterator[str]:
    """The lines of the formats, and how a format is added."""
    width = max(len(reader.name) for reader in readers())
    for reader in readers():
        keys = f"; [log] {', '.join(reader.settings)}" if reader.settings else ""
        yield f"{reader.name:{width}}  {reader.summary} ({reader.looks_for}{keys})"
    yield (
        "Yours: a replan.Reader, as module:NAME or by an entry point of the group "
        f"{READER.group}; docs/extend.md."
    )


def table() -> list[dict[str, Any]]:
    """The content of `listing`, as data."""
    keys = ("name", "summary", "looks_for", "suffixes", "settings")
    return [{key: getattr(reader, key) for key in keys} for reader in readers()]


def convert_all(
    logs: Sequence[Path],
    out: Path,
    settings: LogSettings,
    *,
    foxglove: bool = False,
    say: Callable[[str], None],
    say_error: Callable[[str], None],
) -> bool:
    """Write logs as native MCAP, into `out` if its suffix is .mcap, else into that folder; return
    whether all are read.

    With `foxglove` they get channels that Foxglove draws. If the first name is not a path but the
    name of a reader, that reader reads all files, whatever their names. ConfigError, with nothing
    written, if a path does not exist, there is nothing to convert, several logs are to go into one
    file, a log would be written over itself or another, or the package for Foxglove is not
    installed; OutputError if a log cannot be written.
    """
    reader = None
    first = str(logs[0])
    if not logs[0].exists() and (
        ":" in first or first in {known_reader.name for known_reader in readers()}
    ):
        reader, logs = reader_called(first), logs[1:]
    sources = [log for path in logs for log in _logs_at(path, reader, settings, say)]
    if not sources:
        raise ConfigError("no logs to convert; `replan convert --formats` lists what replan reads")
    if out.suffix == ".mcap" and len(sources) > 1:
        raise ConfigError(f"{len(sources)} logs do not go into one log: give a folder with -o")
    names = [
        f"{log.name if log.is_dir() else log.stem.removesuffix('.cr')}.mcap" for log in sources
    ]
    last = dict(zip(names, sources, strict=True))
    for name, log in zip(names, sources, strict=True):
        if last[name] != log:
            raise ConfigError(
                f"{log} and {last[name]} would both become {out / name}; convert them into two "
                "folders"
            )
    channels = _channels(foxglove=foxglove)
    all_read = True
    with claimed_files(
        out, (".mcap",), _is_ours((log, reader_of(log, settings)) for log in sources)
    ) as path_of:
        targets = [path_of(name) for name in names]
        for log, target in zip(sources, targets, strict=True):
            try:
                scenario = read_log(log, settings, reader)
                write_scenario(target, scenario, beside=channels(scenario))
            except LogError as error:
                say_error(str(error))
                all_read = False
                continue
            say("\n".join([str(target), *(f"    note: {note}" for note in scenario.notes)]))
    return all_read


def _channels(*, foxglove: bool) -> Callable[[Scenario], Iterable[Entry]]:
    """What is written beside a log: nothing, or what Foxglove draws; ConfigError if its package is
    not installed.
    """
    if not foxglove:
        return lambda scenario: ()
    from replan.draw.foxglove import scenario_messages
    from replan.mine.mined_log import markers

    return lambda scenario: scenario_messages(scenario, markers(scenario))


def _logs_at(
    path: Path, asked: Reader | None, settings: LogSettings, say: Callable[[str], None]
) -> Iterator[Path]:
    """The log, or those of a folder.

    Files named like logs that no reader claims are named as left out.
    """
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder")
    if asked is not None or not path.is_dir() or reader_of(path, settings) is not None:
        yield path
        return
    for log, reader in logs_in(path, settings):
        if reader is None:
            say(f"left out {log}: no reader recognises it")
        else:
            yield log


def _is_ours(logs: Iterable[tuple[Path, Reader | None]]) -> Callable[[Path], bool]:
    """Whether an earlier file is a log of replan, and none of these logs, which are read."""
    read = {
        os.path.realpath(file)
        for log, reader in logs
        for file in ((log,) if reader is None else reader.files(log))
    }

    def is_ours(file: Path) -> bool:
        return os.path.realpath(file) not in read and is_written_here(file)

    return is_ours


def repair_log(log: Path, target: Path, table: Path | None, settings: LogSettings) -> Scenario:
    """Read a log, write it as native MCAP, and its changes as CSV; the scenario, whose `repair` may
    be None.

    ConfigError, with nothing written, if there is no such log, or a file of it would be
    overwritten; LogError if the log cannot be read; OutputError if a file cannot be written.
    """
    if not log.exists():
        raise ConfigError(f"{log}: no such file or folder")
    reader = reader_of(log, settings)
    with ExitStack() as claims:
        claims.enter_context(claimed_file(target, (".mcap",), _is_ours([(log, reader)])))
        if table is not None:
            claims.enter_context(claimed_file(table, (".csv",), _has_changes))
        scenario = read_log(log, settings, reader)
        write_scenario(target, scenario)
        if table is not None:
            rows = (astuple(change) for change in changes(scenario))
            text = StringIO(CHANGES_HEADER)
            text.seek(0, 2)
            csv.writer(text, lineterminator="\n").writerows(
                map(csv_cell, (*values, " ".join(sources))) for *values, sources in rows
            )
            write_text(table, text.getvalue())
    return scenario


def changes(scenario: Scenario) -> tuple[TrackChange, ...]:
    """The changes of the repair; empty if there was none."""
    return () if scenario.repair is None else scenario.repair.changes


def changes_as_text(scenario: Scenario) -> Iterator[str]:
    """The changes as text, one line each."""
    if scenario.repair is None:
        yield (
            "    not repaired: the log's road users are tracks already (--repair on does it all "
            "the same)"
        )
    width = max((len(change.agent) for change in changes(scenario)), default=0)
    for change in changes(scenario):
        yield (
            f"    {change.what:10} {change.agent:{width}} {change.begin:7.2f} to "
            f"{change.end:7.2f} s  {change.why}"
        )


def unrepaired(log: Path, settings: LogSettings, scenario: Scenario) -> Scenario | None:
    """The log of a repaired scenario as it was before the repair; None if the log has no tracks of
    its own.
    """
    if scenario.repair is None:
        return None
    raw = read_log(log, replace(settings, repair="off"))
    return raw if raw.repair is None and len(raw.tracks) else None


# Vehicle type in a benchmark id, by the vehicle's name in replan
TYPES = {"bmw_320i": 2, "vw_vanagon": 3}
COSTS = ("JB1", "SA1", "WX1", "SM1", "SM2", "SM3", "MW1", "TR1")
"""Cost functions of CommonRoad: the file only names them, and CommonRoad computes the cost."""
VERSION = "2020a"


def commonroad_solution(trace: Path, cost: str = COSTS[0]) -> str:
    """The solution file of a closed drive over a CommonRoad scenario, XML.

    `trace`: `closed.mcap` of a result folder. `cost`: the cost function that the benchmark id
    names. LogError if the file is not such a trace, or its vehicle is not one of CommonRoad's.
    """
    try:
        scenario = read_scenario(trace)
        return _solution(scenario, cost)
    except LogError as error:
        raise error if error.file is not None else error.at(trace) from None


def solutions(run: Path, cost: str = COSTS[0]) -> tuple[dict[str, str], list[str]]:
    """The solution files of the closed drives of a run by name, and why other closed drives have
    none.

    ConfigError if the path is not a result folder.
    """
    results, files, skipped = load(run), dict[str, str](), list[str]()
    closed = results.drives.loc[results.drives["mode"] == "closed", ["log", "planner"]]
    several = closed["planner"].nunique() > 1
    labels = {
        key: ".".join(key if several else key[:1])
        for key in closed.itertuples(index=False, name=None)
    }
    names = safe_names(labels.values())
    for (log, planner), label in labels.items():
        try:
            drive = results.drive(log, planner, "closed")
            files[f"{names[label]}.xml"] = commonroad_solution(drive.trace_file, cost)
        except LogError as error:
            skipped.append(str(error))
    return files, skipped


def _solution(scenario: Scenario, cost: str) -> str:
    facts = scenario.metadata
    if "benchmark" not in facts or facts.get("trace_mode") != "closed" or scenario.controls is None:
        remedy = "name closed.mcap of a CommonRoad scenario in a result folder"
        raise LogError("no closed drive over a CommonRoad scenario", remedy=remedy)
    car, dt = scenario.vehicle, float(facts["time_step_s"])
    sizes = ((vehicle_parameters(name), number) for name, number in TYPES.items())
    size = (car.length, car.width, car.wheelbase)
    kind = next(
        (
            number
            for parameters, number in sizes
            if (parameters.length, parameters.width, parameters.wheelbase) == size
        ),
        None,
    )
    if kind is None:
        remedy = f"drive with --vehicle kinematic_bicycle --car {' or '.join(TYPES)}"
        raise LogError("the vehicle is not one of CommonRoad's", topic="/vehicle", remedy=remedy)
    first = round(scenario.start_ns / 1e9 / dt)
    driven = (
        _carried_on(scenario, dt)
        if facts.get("trace_end") == EndReason.GOAL.name.lower()
        else scenario.ego
    )
    steps = np.arange(int(driven.t[-1] / dt + 1e-6) + 1)
    ego = driven.resampled(np.minimum(dt * steps, driven.t[-1]))
    steer = np.interp(dt * steps, scenario.controls.t, np.nan_to_num(scenario.controls.steer))
    behind = car.wheelbase - car.cog_to_front
    x = ego.x + behind * np.cos(ego.yaw) + scenario.origin[0]  # (1)
    y = ego.y + behind * np.sin(ego.yaw) + scenario.origin[1]
    root = ET.Element(
        "CommonRoadSolution", benchmark_id=f"KS{kind}:{cost}:{facts['benchmark']}:{VERSION}"
    )
    path = ET.SubElement(root, "ksTrajectory", planningProblem=facts["planning_problem"])
    for k in steps:
        state = ET.SubElement(path, "ksState")
        values = {
            "x": x[k],
            "y": y[k],
            "steeringAngle": steer[k],
            "velocity": ego.v[k],
            "orientation": ego.yaw[k],
        }
        for name, value in values.items():
            ET.SubElement(state, name).text = repr(float(value))
        ET.SubElement(state, "time").text = str(first + int(k))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _carried_on(scenario: Scenario, dt: float) -> Trajectory:
    """The drive, extended to the next time step (2)."""
    ego, last = scenario.ego, scenario.ego.state(-1)
    remaining_s = dt * np.ceil(last.t / dt - 1e-6) - last.t
    if remaining_s < 1e-6:
        return ego
    s = max(last.v * remaining_s + 0.5 * last.a * remaining_s**2, 0.0)
    yaw = last.yaw + s * last.kappa
    middle = 0.5 * (last.yaw + yaw)
    state = (
        last.t + remaining_s,
        last.x + s * np.cos(middle),
        last.y + s * np.sin(middle),
        yaw,
        max(last.v + last.a * remaining_s, 0.0),
        last.a,
        last.kappa,
    )
    return Trajectory(
        *(np.r_[getattr(ego, name), x] for name, x in zip(TRAJECTORY_COLUMNS, state, strict=True))
    )
