"""Argoverse 2 as published: sensor logs (folders of feather files) and motion-forecasting scenarios (Parquet).

Modules:
    sensor.py        poses and boxes of a sensor log
    forecasting.py   tracks of a motion-forecasting scenario
    map.py           log_map_archive_*.json -> Road
"""

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


def _is_sensor_log(path: Path) -> bool:
    return path.name == POSES or (path / POSES).is_file()


def _read(path: Path, settings: LogSettings) -> Scenario:
    from logs.readers.argoverse2.forecasting import read_forecasting
    from logs.readers.argoverse2.sensor import read_sensor_log
    from logs.readers.recorded.tables import reading

    with reading(path):
        if _is_sensor_log(path):
            if settings.ego:
                raise LogError(f"ego {settings.ego} is asked for, but a sensor log has its ego", remedy="leave ego out")
            return read_sensor_log(path.parent if path.name == POSES else path, settings)
        return read_forecasting(_table(path), settings)


def _table(path: Path) -> Path:
    """The Parquet file of a motion-forecasting scenario, given it or its folder."""
    return min(path.glob(SCENARIO)) if path.is_dir() else path


def scenario_id(table: Path) -> str:
    """The id of a motion-forecasting scenario, from the name of its file."""
    return table.stem.removeprefix("scenario_")


def _files(path: Path) -> tuple[Path, ...]:
    from logs.readers.argoverse2.map import map_beside

    if _is_sensor_log(path):
        from logs.readers.argoverse2.sensor import files_of

        return files_of(path.parent if path.name == POSES else path)
    table = _table(path)
    return tuple(each for each in (table, map_beside(table.parent, scenario_id(table))) if each is not None)


def _contents(path: Path) -> Contents:
    from logs.readers.argoverse2 import forecasting, sensor

    if _is_sensor_log(path):
        return sensor.contents_of(path.parent if path.name == POSES else path)
    return forecasting.contents_of(_table(path))


READER = Reader(
    "argoverse2", "Argoverse 2 sensor logs and motion-forecasting scenarios",
    f"folders with {POSES} or {SCENARIO}", (), _claims, _read, files=_files, contents=_contents,
    settings=("ego", "car"),
)  # fmt: skip
