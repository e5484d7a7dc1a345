"""Runs the paper's experiments: figures, recordings, the comparison of controllers, variations of
the pedestrian.

    OUT/fig09_path.png            planned and driven path on paper/free_road, lateral error over
                                  station
    OUT/fig10_st.png              scene and S-T graph before, while and after the pedestrian blocks
                                  the path
    OUT/fig12_pedals.png          throttle, brake and speed, the braking marked
    OUT/free_road.rrd             the recordings, for `replan view`
    OUT/crossing_pedestrian.rrd
    OUT/manoeuvres.csv            controllers x manoeuvres, without a planner
                                  (replan.paper.manoeuvres)
    OUT/scenarios.csv             controllers x the paper's scenarios, with the planner
    OUT/pedestrian_grid.csv       and .png: the pedestrian varied (replan.paper.pedestrian_grid)
    OUT/paper.md                  all of it on one page

The files contain no measured times except the planner's stage times in the recordings: two runs
otherwise give the same bytes. Each file is written under a temporary name and renamed.
docs/paper.md compares the results with the paper.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, unknown_name
from replan.draw.recording import write_recording
from replan.logs.catalogue import paper
from replan.logs.plan import StGraph
from replan.logs.scenario import Scenario
from replan.logs.trace import PlannedFrame, Trace
from replan.metrics import METRICS, evaluate, evaluate_with_series
from replan.paper.figures import grid_figure, path_figure, pedals_figure, st_figure
from replan.paper.manoeuvres import compare
from replan.paper.pedestrian_grid import (
    CELLS,
    LOOP,
    PLANNER,
    GridCrossing,
    braking_for_walker,
    grid,
)
from replan.replay.drive import Drive
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.parts import CONTROLLER, VEHICLE
from replan.results.tables import write_csv, write_text
from replan.run.claim import FolderContents

Say = Callable[[str], None]
FILES = (
    "fig09_path.png",
    "fig10_st.png",
    "fig12_pedals.png",
    "free_road.rrd",
    "crossing_pedestrian.rrd",
    "manoeuvres.csv",
    "scenarios.csv",
    "pedestrian_grid.*",
    "paper.md",
)
CONTENTS = FolderContents("paper", FILES, resumes=False)
DIGITS = "%.6g"  # The format of numbers in the tables


@dataclass(frozen=True)
class PaperConfig:
    """The extent of the experiments.

    ConfigError if a vehicle model is unknown, or a number is negative.

    Attributes:
        vehicles: Vehicle models of the tables of controllers; the figures use the first one.
        roads: Seeded roads among the manoeuvres.
        cells: Cells of the pedestrian grid.
        workers: Number of processes for the grid; 0: this process. The results are the same.
    """

    vehicles: tuple[str, ...] = ("single_track",)
    roads: int = 50
    cells: tuple[GridCrossing, ...] = CELLS
    workers: int = 0

    def __post_init__(self) -> None:
        for name in self.vehicles:
            if name not in VEHICLE.builtin:
                raise unknown_name("vehicle", name, VEHICLE.builtin)
        if not self.vehicles or min(self.roads, self.workers) < 0:
            raise ConfigError("paper: name a vehicle; roads and workers must not be negative")


DEFAULT = PaperConfig()


def reproduce(out: Path, config: PaperConfig = DEFAULT, *, say: Say = lambda line: None) -> Path:
    """Run all experiments; `say` is called with each step. Returns the page `paper.md`.

    The folder exists, and is claimed by the caller (`CONTENTS`).
    """
    say("scenario 1: the free road")
    first = free_road(out, config.vehicles[0])
    say("scenario 2: the crossing pedestrian")
    second = crossing_pedestrian(out, config.vehicles[0])
    say("controllers x scenarios")
    scenarios = scenario_table(config.vehicles)
    write_csv(out / "scenarios.csv", scenarios, float_format=DIGITS)
    say(f"controllers x manoeuvres, {config.roads} roads among them")
    manoeuvres = compare(
        [v for v in config.vehicles if v != "perfect"], list(CONTROLLER.builtin), roads=config.roads
    )
    write_csv(out / "manoeuvres.csv", manoeuvres, float_format=DIGITS)
    say(f"the pedestrian varied: {len(config.cells)} drives")

    def count(cells: int) -> None:
        if cells % 20 == 0 or cells == len(config.cells):
            say(f"    {cells} of {len(config.cells)}")

    cells = grid(config.cells, workers=config.workers, on_cell=count)
    write_csv(out / "pedestrian_grid.csv", cells, float_format=DIGITS)
    grid_figure(cells).save(out / "pedestrian_grid.png")
    page = out / "paper.md"
    write_text(page, _page(first, second, scenarios, manoeuvres, cells))
    return page


def drive(scenario: Scenario, vehicle: str, controller: str) -> Drive:
    """One closed loop of the paper's planner."""
    return run_closed_loop(
        scenario, PLANNER, config=replace(LOOP, vehicle=vehicle, controller=controller)
    )


def free_road(out: Path, vehicle: str) -> dict[str, str]:
    """Make Fig. 9 and its recording; returns its facts in words."""
    scenario = paper.free_road.scenario()
    drives = {name: drive(scenario, vehicle, name) for name in ("mpc", "dlqr_pid")}
    traces = [(name, controlled.trace) for name, controlled in drives.items()]
    path_figure(traces, planned_points(drives["mpc"].trace), scenario).save(out / "fig09_path.png")
    write_recording(
        out / "free_road.rrd",
        drives["mpc"],
        scenario,
        *evaluate_with_series(drives["mpc"].trace, scenario),
    )
    facts = {}
    for name, trace in traces:
        assert trace.tracking is not None, "closed loops have tracking errors"
        off = 1e3 * trace.tracking.lateral
        facts[f"lateral error, {name}"] = (
            f"{np.sqrt(np.mean(off**2)):.1f} mm RMS, {np.abs(off).max():.1f} mm at most; ended by: "
            f"{trace.end.value}"
        )
    return facts


def crossing_pedestrian(out: Path, vehicle: str) -> dict[str, str]:
    """Make Fig. 10, Fig. 12 and their recording; returns their facts in words."""
    scenario = paper.crossing_pedestrian.scenario()
    driven = drive(scenario, vehicle, "mpc")
    trace = driven.trace
    moments = blocked_moments(trace.frames)
    st_figure(moments, trace, scenario).save(out / "fig10_st.png")
    clear, braking = braking_for_walker(trace, scenario)
    ends = (paper.crossing_pedestrian.parameters["walk_start_s"] - 2.0, clear + 8.0)
    pedals_figure(trace, braking, clear, ends).save(out / "fig12_pedals.png")
    write_recording(
        out / "crossing_pedestrian.rrd", driven, scenario, *evaluate_with_series(trace, scenario)
    )
    return {
        (
            "path blocked in the S-T graph"
        ): f"from {moments[0][1].t:.1f} s until {moments[-1][1].t:.1f} s",
        "braking": ", ".join(
            f"{begin:.2f} to {end:.2f} s ({end - begin:.2f} s)" for begin, end in braking
        )
        or "none",
        "the walker has left the path": f"{clear:.2f} s",
        "least speed": f"{trace.ego.v.min():.2f} m/s",
        "ended by": trace.end.value,
    }


def planned_points(trace: Trace) -> FloatArray:
    """Positions `(n, 2)` of the rear axle by the plan in force at each time of the drive, m,
    without plan delay.
    """
    starts = np.array([frame.t for frame in trace.frames])
    owner = np.searchsorted(starts, trace.ego.t + 1e-9) - 1
    points = [
        trace.frames[k].plan.trajectory.at(t)
        for k, t in zip(owner, trace.ego.t.tolist(), strict=True)
    ]
    return np.array([(state.x, state.y) for state in points])


def blocked_moments(frames: Sequence[PlannedFrame]) -> list[tuple[str, PlannedFrame]]:
    """The first frame in which an agent is in the S-T graph, the middle one, and the first one
    after the last.

    ConfigError if no agent is ever in the S-T graph, or one is until the end.
    """
    blocked = [i for i, frame in enumerate(frames) if _is_blocked(frame)]
    if not blocked or blocked[-1] + 1 >= len(frames):
        raise ConfigError(
            "Fig. 10 needs a drive in which a road user blocks the path and leaves it"
        )
    chosen = (blocked[0], blocked[len(blocked) // 2], blocked[-1] + 1)
    words = ("first blocked", "in the middle", "free again")
    return [(word, frames[i]) for word, i in zip(words, chosen, strict=True)]


def _is_blocked(frame: PlannedFrame) -> bool:
    """Whether an agent is in an S-T graph of the plan."""
    return any(isinstance(graph, StGraph) and graph.obstacles for graph in frame.plan.internals)


SCENARIO_COLUMNS: dict[str, str] = {
    "lateral_rms_m": "tracking_lateral.rms",
    "lateral_max_m": "tracking_lateral.max_abs",
    "heading_max_deg": "tracking_heading.max_abs",
    "speed_max_mps": "tracking_speed.max_abs",
    "station_max_m": "tracking_station.max_abs",
    "steer_rate_max_radps": "steer_rate.max_abs",
    "jerk_max_mps3": "lon_jerk_state.max_abs",
    "least_gap_m": "gap.min",
    "pedals_together": "pedals_together.count",
    "pedal_switches": "pedal_switches.count",
    "fallback_rate": "fallback.rate",
}


def scenario_table(vehicles: Sequence[str]) -> pd.DataFrame:
    """A row per vehicle model, scenario of the paper and controller.

    Last the perfect vehicle, as the bound.
    """
    names = {name.partition(".")[0] for name in SCENARIO_COLUMNS.values()}
    metrics = {name: metric for name, metric in METRICS.items() if name in names}
    models = [vehicle for vehicle in vehicles if vehicle != "perfect"]
    pairs = product(models, CONTROLLER.builtin)
    drives = [*pairs, ("perfect", "dlqr_pid")]
    rows: list[dict[str, object]] = []
    for family in paper.FAMILIES:
        scenario = family.scenario()
        for vehicle, controller in drives:
            trace = drive(scenario, vehicle, controller).trace
            values = evaluate(trace, scenario, metrics=metrics).set_index("metric")["value"]
            head = {"vehicle": vehicle, "scenario": scenario.name, "end": trace.end.value}
            head["controller"] = "none" if vehicle == "perfect" else controller
            rows.append(
                head
                | {column: float(values[metric]) for column, metric in SCENARIO_COLUMNS.items()}
            )
    table = pd.DataFrame(rows)[["vehicle", "scenario", "controller", "end", *SCENARIO_COLUMNS]]
    return table.assign(heading_max_deg=np.degrees(table["heading_max_deg"]))


def markdown(table: pd.DataFrame) -> str:
    """A table in Markdown; numbers have three digits; `-` is NaN."""
    lines = ["| " + " | ".join(table.columns) + " |", "|" + "---|" * len(table.columns)]
    rows = table.itertuples(index=False)
    lines += ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    return "-" if np.isnan(value) else f"{value:.3g}"


FAILED_COLUMNS = (
    "ego_kmh",
    "walker_mps",
    "late_s",
    "verdict",
    "contact_t_s",
    "contact_v_mps",
    "least_gap_m",
    "brake_begin_s",
    "braking_s",
    "path_clear_s",
    "release_after_clear_s",
    "peak_decel_mps2",
    "peak_jerk_mps3",
    "first_reason",
)
"""Columns of the page's table of the cells in which something failed."""


def _page(
    first: dict[str, str],
    second: dict[str, str],
    scenarios: pd.DataFrame,
    manoeuvres: pd.DataFrame,
    cells: pd.DataFrame,
) -> str:
    """The text of paper.md."""
    counts = cells["verdict"].value_counts(sort=False)
    bad = cells[~cells["verdict"].isin(["ok", "unavoidable"])]
    lists = [
        "\n".join(f"- {key}: {value}" for key, value in facts.items()) for facts in (first, second)
    ]
    return "\n\n".join(
        [
            "# The paper's experiments",
            "Made by `replan paper`. Recordings: `replan view free_road.rrd`, `replan view "
            "crossing_pedestrian.rrd`.",
            "## Fig. 9: planned and driven path",
            "![planned and driven path](fig09_path.png)",
            lists[0],
            "## Fig. 10: S-T graph before, while and after the pedestrian is in the way",
            "![scene and S-T graph](fig10_st.png)",
            "## Fig. 12: throttle and brake",
            "![throttle, brake, speed](fig12_pedals.png)",
            lists[1],
            "## Controllers x scenarios",
            markdown(scenarios),
            "## Controllers x manoeuvres",
            markdown(manoeuvres),
            "## The pedestrian varied",
            "![heat maps](pedestrian_grid.png)",
            f"{len(cells)} drives: "
            + ", ".join(f"{count} {word}" for word, count in counts.items())
            + ".",
            markdown(bad[list(FAILED_COLUMNS)]) if len(bad) else "Nothing failed.",
            "",
        ]
    )
