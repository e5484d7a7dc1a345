"""Logs of two or three seconds, and runs over them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from handmade import drive, lanes_along, scenario, square, straight, track, tracks

from replan.config import RunConfig
from replan.draw.drawn_results import Results
from replan.logs.mcap import write_scenario
from replan.logs.road import Goal
from replan.logs.scenario import Scenario
from replan.run import evaluate_logs

QUICK = RunConfig(planners=("constant_speed",), recording=False)


def short(name: str, *, v: float = 10.0, parked: bool = False) -> Scenario:
    """Two seconds straight on."""
    log = drive(straight, v, 2.0)
    others = tracks(track("parked", [0.0], [60.0], [3.0], static=True)) if parked else None
    made = scenario(
        log, agents=others, road=lanes_along(log), goal=Goal((square(v * 2.0, 0.0, 4.0),))
    )
    return replace(made, name=name, tags=("short",))


def past_parked(name: str, x: float, *others: dict[str, object]) -> Scenario:
    """3 s at 8 m/s towards a goal, car 17 parked at x, 5 m beside the lane."""
    ego = drive(straight, 8.0, 2.9)
    parked = track("17", [0.0], [x], [5.0], static=True)
    road, goal = lanes_along(ego, width=5.0), Goal((square(24.0, 0.0, 4.0),))
    return replace(scenario(ego, road=road, goal=goal, agents=tracks(parked, *others)), name=name)


def free_and_blocked() -> tuple[Scenario, Scenario]:
    """Not quite three seconds each: no one is there, and a car parked where a careful driver still
    stops.
    """
    ego = drive(straight, 8.0, 2.9)
    free = scenario(ego, road=lanes_along(ego), goal=Goal((square(27.0, 0.0, 4.0),)))
    wall = tracks(track("wall", [0.0], [24.0], [0.0], static=True))
    return replace(free, name="test/free"), replace(free, tracks=wall, name="test/blocked")


def write_free_and_blocked(folder: Path) -> Path:
    """`free.mcap` and `blocked.mcap`, in a folder that is made if needed; the folder."""
    folder.mkdir(exist_ok=True)
    for name, log in zip(("free", "blocked"), free_and_blocked(), strict=True):
        write_scenario(folder / f"{name}.mcap", log)
    return folder


def run(
    logs: Path | Sequence[Path], out: Path, config: RunConfig = QUICK, **options: int
) -> Results:
    return evaluate_logs([logs] if isinstance(logs, Path) else logs, config, out, **options)


def identical(first: Path, second: Path) -> bool:
    """Whether everything that must not depend on the run is the same, byte for byte."""
    names = ["metrics.parquet", "metrics.csv"]
    for pattern in ("*/metrics.parquet", "*/frames.parquet", "*/*.mcap"):
        names += [str(path.relative_to(first)) for path in first.glob(pattern)]
    return all((first / name).read_bytes() == (second / name).read_bytes() for name in names)
