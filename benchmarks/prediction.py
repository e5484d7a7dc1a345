"""How far predictions are off the log, per method and source, and how long they take.

    python benchmarks/prediction.py FOLDER_OF_COMMONROAD_FILES [--every 1.0] [--kind pedestrian]
    python benchmarks/prediction.py FOLDER_OF_COMMONROAD_FILES --frames      what perception and
        prediction cost

With `--frames`: CPU time of a whole `Frame` with the loop's defaults, over the built-in suite, and
over each file's road with `CROWDS` made-up agents on it, nine vehicles to a pedestrian.

At a frame every so many seconds, each agent that moves (or moved within the log) is predicted, and
compared with where the log has it 1, 2, 4 and 6 s later. `likely` is the error of the most probable
hypothesis, `best` of the nearest one whose probability is at least 0.1; means over all agents and
frames that have a sample so much later.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from crowds import CROWDS, crowded

from replan.logs.agents import Agents
from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import Predictions
from replan.logs.readers.commonroad import read_commonroad
from replan.logs.scenario import Scenario
from replan.replay.loop_config import DEFAULT_LOOP
from replan.replay.parts import PREDICTION
from replan.replay.perception import Perception
from replan.replay.prediction import LaneMap, predict
from replan.replay.world import World, logged_ego

HORIZONS_S = (1.0, 2.0, 4.0, 6.0)
STEP_S = 0.1
PASSES = 5
SOURCES = ("mona", "ngsim", "sumo")


def source_of(scenario: Scenario) -> str:
    """The recording that a log comes from."""
    return next((name for name in SOURCES if name in scenario.tags), "hand")


def movers(scenario: Scenario) -> frozenset[str]:
    """Who covers at least 2 m in the log."""
    tracks = scenario.tracks
    spans = [tracks.samples(i) for i in range(len(tracks))]
    return frozenset(
        name
        for name, span in zip(tracks.ids, spans, strict=True)
        if np.hypot(np.ptp(tracks.x[span]), np.ptp(tracks.y[span])) >= 2.0
    )


def errors(
    agents: Agents, future: Predictions, later: Agents, ahead: float
) -> Iterator[tuple[str, float, float]]:
    """Id, error of the most probable and of the best hypothesis, of each agent that is still there,
    m.
    """
    k = round(ahead / STEP_S)
    where = {name: i for i, name in enumerate(later.ids)}
    for i, name in enumerate(agents.ids):
        if name not in where:
            continue
        mine = np.flatnonzero(future.agent == i)
        off = np.hypot(
            future.x[mine, k] - later.x[where[name]], future.y[mine, k] - later.y[where[name]]
        )
        yield name, float(off[np.argmax(future.probability[mine])]), float(off.min())


def rows(
    scenario: Scenario, method: str, every: float
) -> Iterator[tuple[str, str, float, str, float, float, float]]:
    """Source, method, horizon, kind, both errors and the milliseconds of the frame's prediction."""
    lanes, moving = LaneMap.of(scenario.road), movers(scenario)
    kinds = dict(zip(scenario.tracks.ids, scenario.tracks.kinds, strict=True))
    for t in np.arange(0.5, scenario.duration, every):
        agents = scenario.tracks.perceived(float(t))
        begin = time.perf_counter()
        future = predict(agents, float(t), horizon=8.0, step=STEP_S, method=method, lanes=lanes)
        took = 1e3 * (time.perf_counter() - begin)
        for ahead in HORIZONS_S:
            for name, likely, best in errors(
                agents, future, scenario.tracks.truth(float(t) + ahead), ahead
            ):
                if name in moving:
                    yield source_of(scenario), method, ahead, kinds[name].value, likely, best, took


def frame_us(scenario: Scenario) -> float:
    """CPU time of a frame of the first seconds of a log, us: the best of some passes."""
    perception = Perception(scenario, DEFAULT_LOOP)
    times = np.arange(0.0, min(scenario.duration, 3.0), 0.1)
    worlds = [
        World(logged_ego(scenario.ego, scenario.vehicle, float(t)), scenario.tracks) for t in times
    ]
    found = []
    for _ in range(PASSES):
        begin = time.process_time()
        for world in worlds:
            perception.frame(world, None)
        found.append(1e6 * (time.process_time() - begin) / len(worlds))
    return min(found)


def print_frames(folder: Path) -> None:
    """The table of `--frames`."""
    suite = pd.Series({name: frame_us(family.scenario()) for name, family in CATALOGUE.items()})
    print(
        f"us a frame, built-in suite: median {suite.median():.0f}, most {suite.max():.0f} "
        f"({suite.idxmax()})"
    )
    roads = [read_commonroad(path) for path in sorted(folder.glob("*.xml"))]
    made = {road.name: [frame_us(crowded(road, n)) for n in CROWDS] for road in roads}
    print(
        pd.DataFrame(made, index=[f"{n} agents" for n in CROWDS])
        .T.describe()
        .loc[["50%", "max"]]
        .round(0)
        .to_string()
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--every", type=float, default=1.0, help="seconds between two frames")
    parser.add_argument("--kind", help="only road users of this kind")
    parser.add_argument("--frames", action="store_true", help="what a frame costs")
    told = parser.parse_args()
    if told.frames:
        print_frames(told.folder)
        return
    scenarios = [read_commonroad(path) for path in sorted(told.folder.glob("*.xml"))]
    found = [
        row
        for s in scenarios
        for method in PREDICTION.causal
        for row in rows(s, method, told.every)
    ]
    names = ["source", "method", "ahead_s", "kind", "likely_m", "best_m", "ms"]
    table = pd.DataFrame(found, columns=names)
    if told.kind:
        table = table[table.kind == told.kind]
    means = table.groupby(["source", "method", "ahead_s"], sort=False)[
        ["likely_m", "best_m"]
    ].mean()
    print(means.unstack("ahead_s").round(2).to_string())
    print("\nagents and frames compared:")
    print(
        table.groupby(["source", "ahead_s"])
        .size()
        .unstack()
        .div(len(PREDICTION.causal))
        .astype(int)
        .to_string()
    )
    print("\nmilliseconds per frame:")
    print(
        table.groupby("method", sort=False)["ms"]
        .describe(percentiles=[0.5, 0.99])[["50%", "99%"]]
        .round(2)
        .to_string()
    )


if __name__ == "__main__":
    main()
