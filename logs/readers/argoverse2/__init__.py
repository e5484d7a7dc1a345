"""Argoverse 2 as published: sensor logs (folders of feather files) and motion-forecasting scenarios (Parquet)."""

from __future__ import annotations

from pathlib import Path

from logs.errors import LogError
from logs.readers.base import Contents, LogSettings, Reader
from logs.scenario import Scenario

POSES = "city_SE3_egovehicle.feather"
SCENARIO = "scenario_*.parquet"


def _claims(path: Path) -> bool:
    try:
        if path.is_dir():
            return (path / POSES).is_file() or len(list(path.glob(SCENARIO))) == 1
        return path.name == POSES or (
            path.match(SCENARIO) and (path.parent / f"log_map_archive_{scenario_id(path)}.json").is_file()
        )
    except OSError:
        return False


def _located(path: Path) -> tuple[Path, bool]:
    """The folder of a sensor log or the table of a motion-forecasting scenario, and whether it is a sensor log."""
    if path.name == POSES:
        return path.parent, True
    if (path / POSES).is_file():
        return path, True
    return (min(path.glob(SCENARIO)) if path.is_dir() else path), False


def scenario_id(table: Path) -> str:
    """The id of a motion-forecasting scenario, from the name of its file."""
    return table.stem.removeprefix("scenario_")


def _read(path: Path, settings: LogSettings) -> Scenario:
    from logs.readers.argoverse2.read import read_forecasting, read_sensor_log
    from logs.readers.recorded.tables import reading

    with reading(path):
        log, is_sensor_log = _located(path)
        if not is_sensor_log:
            return read_forecasting(log, settings)
        if settings.ego:
            raise LogError(f"ego {settings.ego} is asked for, but a sensor log has its ego", remedy="leave ego out")
        return read_sensor_log(log, settings)


def _files(path: Path) -> tuple[Path, ...]:
    from logs.readers.argoverse2.read import map_beside, sensor_files

    log, is_sensor_log = _located(path)
    if is_sensor_log:
        return sensor_files(log)
    return tuple(each for each in (log, map_beside(log.parent, scenario_id(log))) if each is not None)


def _contents(path: Path) -> Contents:
    from logs.readers.argoverse2.read import forecasting_contents, sensor_contents

    log, is_sensor_log = _located(path)
    return sensor_contents(log) if is_sensor_log else forecasting_contents(log)


READER = Reader(
    "argoverse2", "Argoverse 2 sensor logs and motion-forecasting scenarios",
    f"folders with {POSES} or {SCENARIO}", (), _claims, _read, files=_files, contents=_contents,
    settings=("ego", "car"),
)  # fmt: skip
