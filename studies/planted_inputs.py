"""Does `replan diagnose RUN --against BASELINE` name what a planner is fed?

python -m studies.planted_inputs -o OUT [--only NAME ...] [--workers N]

`dp_qp` drives the built-in suite as it is, and behind each fault of `FAULTS`: its input, its
predictions, its context, its settings or its plan are changed by code that shares nothing with
`replan.explain.input_changes`. An answer is right if it names the fault's cause and every change of
it with its size, also among changes that no frame separates; wrong if it names another cause or
size; open if it names none.

    OUT/baseline/, OUT/NAME/    the runs
    OUT/planted_inputs.csv      a row per fault: answer, seconds, and the sentences
"""

from __future__ import annotations

import argparse
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from replan.config import load_run
from replan.core.arrays import BoolArray, FloatArray
from replan.core.settings import nested, strict
from replan.draw.drawn_results import Results
from replan.experiments.attribution import Attribution, Pair, attribute
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.plan import Plan
from replan.logs.rules import Colour
from replan.planners.dp_qp.lane import DpQpConfig
from replan.planners.dp_qp.planner import DpQp
from replan.run import evaluate_logs

Before = Callable[[int], Frame]
"""Gives the frame that is this number of frames earlier."""
Edit = Callable[[Frame, Before], Frame]
"""Returns the changed frame."""
Kinds = tuple[str, ...]


def ahead_and_left(frame: Frame) -> tuple[FloatArray, FloatArray]:
    """Where agents are in the ego's frame, m."""
    turn = np.exp(-1j * frame.ego.yaw)
    place = (frame.agents.x - frame.ego.x + 1j * (frame.agents.y - frame.ego.y)) * turn
    return place.real, place.imag


def near_side(frame: Frame) -> BoolArray:
    """Agents at most 5 m to the side."""
    return np.abs(ahead_and_left(frame)[1]) <= 5.0


def not_behind(frame: Frame) -> BoolArray:
    """Agents that are not behind the rear axle."""
    return ahead_and_left(frame)[0] >= 0.0


def within(frame: Frame, reach: float) -> BoolArray:
    """Agents at most so far away, m."""
    return np.hypot(*ahead_and_left(frame)) <= reach


def without(frame: Frame, kind: str) -> BoolArray:
    """Agents of other kinds."""
    return ~of_kinds(frame, (kind,))


def still_there(frame: Frame, now: Frame) -> BoolArray:
    """Agents that are there now, too."""
    return np.array([name in now.agents.ids for name in frame.agents.ids], dtype=bool)


def only(frame: Frame, before: Before, mask: Callable[[Frame], BoolArray]) -> Frame:
    """The frame with some agents only."""
    rows = np.flatnonzero(mask(frame))
    place = {int(row): n for n, row in enumerate(rows)}
    futures = frame.predictions
    kept = np.array([i for i, row in enumerate(futures.agent) if int(row) in place], dtype=int)
    agent = np.array([place[int(futures.agent[i])] for i in kept], dtype=np.int64)
    predictions = Predictions(
        futures.t,
        agent,
        futures.probability[kept],
        futures.x[kept],
        futures.y[kept],
        futures.yaw[kept],
        futures.method,
    )
    return replace(frame, agents=frame.agents.some(rows), predictions=predictions)


def of_kinds(frame: Frame, kinds: Kinds) -> BoolArray:
    """Which agents are of these kinds; of any without kinds."""
    return np.array([not kinds or kind.value in kinds for kind in frame.agents.kinds], dtype=bool)


def moved(frame: Frame, before: Before, offset: complex, kinds: Kinds = ()) -> Frame:
    """Agents of these kinds, and their predictions, moved in the world, m."""
    agents, futures = frame.agents, frame.predictions
    share = of_kinds(frame, kinds).astype(float)
    rows = share[futures.agent][:, None]
    return replace(
        frame,
        agents=replace(agents, x=agents.x + offset.real * share, y=agents.y + offset.imag * share),
        predictions=replace(
            futures, x=futures.x + offset.real * rows, y=futures.y + offset.imag * rows
        ),
    )


def beside_ego(frame: Frame, before: Before, offset: complex, kinds: Kinds = ()) -> Frame:
    """Agents moved ahead (real) and to the left (imaginary) of the ego, m."""
    return moved(frame, before, complex(offset * np.exp(1j * frame.ego.yaw)), kinds)


def slower(frame: Frame, before: Before, share: float, kinds: Kinds = ()) -> Frame:
    """Predicted displacements times `share`."""
    futures = frame.predictions
    factor = np.where(of_kinds(frame, kinds), share, 1.0)[futures.agent][:, None]
    x = futures.x[:, :1] + factor * (futures.x - futures.x[:, :1])
    y = futures.y[:, :1] + factor * (futures.y - futures.y[:, :1])
    return replace(frame, predictions=replace(futures, x=x, y=y))


def older(frame: Frame, before: Before, count: int) -> Frame:
    """Agents and predictions of an earlier frame."""
    old = before(count)
    return replace(frame, agents=old.agents, predictions=old.predictions)


def dated(frame: Frame, before: Before, count: int) -> Frame:
    """Predictions of an earlier frame, of agents that are still there."""
    old = only(before(count), before, partial(still_there, now=frame))
    order = {name: i for i, name in enumerate(frame.agents.ids)}
    rows = np.array([order[name] for name in old.agents.ids], dtype=np.int64)
    futures = old.predictions
    return replace(frame, predictions=replace(futures, agent=rows[futures.agent]))


def ended(frame: Frame, before: Before, after_s: float) -> Frame:
    """Predictions that end early."""
    futures = frame.predictions
    early = futures.t <= frame.t + after_s + 1e-6
    x, y, yaw = futures.x[:, early], futures.y[:, early], futures.yaw[:, early]
    return replace(frame, predictions=replace(futures, t=futures.t[early], x=x, y=y, yaw=yaw))


def sized(frame: Frame, before: Before, share: float) -> Frame:
    """Boxes of another size."""
    agents = frame.agents
    boxes = replace(agents, length=share * agents.length, width=share * agents.width)
    return replace(frame, agents=boxes)


def turned(frame: Frame, before: Before, angle: float) -> Frame:
    """Boxes turned by an angle, rad."""
    agents, futures = frame.agents, frame.predictions
    return replace(
        frame,
        agents=replace(agents, yaw=agents.yaw + angle),
        predictions=replace(futures, yaw=futures.yaw + angle),
    )


def lit(frame: Frame, before: Before, colours: Sequence[Colour]) -> Frame:
    """Lights of these colours are green."""
    lights = {n: Colour.GREEN if c in colours else c for n, c in frame.lights.items()}
    return replace(frame, lights=lights)


def unlit(frame: Frame, before: Before) -> Frame:
    """No lights."""
    return replace(frame, lights={})


def old_lights(frame: Frame, before: Before, count: int) -> Frame:
    """The lights of an earlier frame."""
    return replace(frame, lights=before(count).lights)


def slow_ego(frame: Frame, before: Before, share: float) -> Frame:
    """The ego's speed times `share`."""
    return replace(frame, ego=replace(frame.ego, v=share * frame.ego.v))


def beside_itself(frame: Frame, before: Before, left: float) -> Frame:
    """The ego moved to its left, m."""
    ego = frame.ego
    x, y = ego.x - left * np.sin(ego.yaw), ego.y + left * np.cos(ego.yaw)
    return replace(frame, ego=replace(ego, x=x, y=y))


def forgetful(frame: Frame, before: Before) -> Frame:
    """The frame without the previous plan."""
    return replace(frame, previous=None)


def faster_road(context: PlannerContext, share: float) -> PlannerContext:
    """Speed limits times `share`."""
    road = context.road
    lanes = {
        n: replace(lane, speed_limit=share * lane.speed_limit) for n, lane in road.lanes.items()
    }
    default = share * road.default_speed_limit
    return replace(context, road=replace(road, lanes=lanes, default_speed_limit=default))


def drawn_out(plan: Plan) -> Plan:
    """The plan driven 15 % slower along its path."""
    old = plan.trajectory
    t = old.t[0] + 0.85 * (old.t - old.t[0])
    columns = {name: np.interp(t, old.t, getattr(old, name)) for name in ("x", "y", "yaw", "kappa")}
    v, a = 0.85 * np.interp(t, old.t, old.v), 0.85**2 * np.interp(t, old.t, old.a)
    return replace(plan, trajectory=replace(old, v=v, a=a, **columns))


class Fault:
    """A planted fault: its cause, the changes that an answer has to name, and its code: edits of
    the frame, one after the other, or a change of settings, context, plan or run.
    """

    def __init__(
        self,
        cause: str,
        changes: str,
        *edits: Edit,
        settings: Mapping[str, Any] = MappingProxyType({}),
        context: Callable[[PlannerContext], PlannerContext] | None = None,
        plan: Callable[[Plan], Plan] | None = None,
        run: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        self.cause, self.edits = cause, edits
        self.changes = frozenset(filter(None, changes.split(" + ")))
        self.settings, self.run = settings, run
        self.context, self.plan = context, plan


RED_AND_YELLOW = (Colour.RED, Colour.RED_YELLOW, Colour.YELLOW)
LEFT = "shift agents left 1.5 of bicycle, pedestrian"
NO_PEDESTRIANS = "drop agents of pedestrian"
to_the_left = partial(beside_ego, offset=1.5j, kinds=("pedestrian", "bicycle"))
no_pedestrians = partial(only, mask=partial(without, kind="pedestrian"))
within_25_m = partial(only, mask=partial(within, reach=25.0))
within_30_m = partial(only, mask=partial(within, reach=30.0))
fast_cars = partial(slower, share=1.4, kinds=("car",))
all_green = partial(lit, colours=RED_AND_YELLOW)
yellow_green = partial(lit, colours=(Colour.YELLOW,))
straight_on = {"loop": {"prediction": "constant_velocity"}}
slow_brakes = {"loop": {"plant": {"brake_lag": 0.8}}}
stands = partial(slower, share=0.0)
FAULTS = {
    "near_side": Fault("input", "drop agents beside 5", partial(only, mask=near_side)),
    "none_behind": Fault("input", "drop agents behind", partial(only, mask=not_behind)),
    "range": Fault("input", "drop agents beyond 25", within_25_m),
    "no_pedestrians": Fault("input", NO_PEDESTRIANS, no_pedestrians),
    "left": Fault("input", LEFT, to_the_left),
    "ahead": Fault("input", "shift agents ahead 1", partial(beside_ego, offset=1.0)),
    "world": Fault("input", "shift agents x 1.2", partial(moved, offset=1.2)),
    "small": Fault("input", "scale agents' size 0.6", partial(sized, share=0.6)),
    "old": Fault("input", "delay agents 11", partial(older, count=11)),
    "turned": Fault("input", "turn agents 0.15", partial(turned, angle=0.15)),
    "ego_left": Fault("input", "shift ego left 0.4", partial(beside_itself, left=0.4)),
    "green": Fault("input", "lights green", all_green),
    "yellow": Fault("input", "yellow lights green", yellow_green),
    "no_lights": Fault("input", "lights gone", unlit),
    "old_lights": Fault("input", "delay lights 15", partial(old_lights, count=15)),
    "limits": Fault("input", "scale speed limits 1.2", context=partial(faster_road, share=1.2)),
    "short_steps": Fault("prediction", "scale predictions 0.55", partial(slower, share=0.55)),
    "all_stand": Fault("prediction", "scale predictions 0", stands),
    "fast_cars": Fault("prediction", "scale predictions 1.4 of car", fast_cars),
    "old_predictions": Fault("prediction", "delay predictions 5", partial(dated, count=5)),
    "short_predictions": Fault("prediction", "cut predictions 2", partial(ended, after_s=2.0)),
    "straight": Fault("prediction", "loop.prediction", run=straight_on),
    "late": Fault("latency", "loop.plan_delay_s", run={"loop": {"plan_delay_s": 0.3}}),
    "slow_brakes": Fault("control", "loop.plant.brake_lag", run=slow_brakes),
    "smooth": Fault("decision", "setting speed.qp.w_j 3 -> 30", settings={"speed.qp.w_j": 30.0}),
    "close": Fault(
        "decision", "setting speed.dp.time_gap_s 1.2 -> 0.4", settings={"speed.dp.time_gap_s": 0.4}
    ),
    "drawn_out": Fault("decision", "", plan=drawn_out),
    "slow_and_forgetful": Fault(
        "input", "scale own speed 0.8 + no previous plan", partial(slow_ego, share=0.8), forgetful
    ),
    "left_and_green": Fault("input", f"{LEFT} + lights green", to_the_left, all_green),
    "range_and_short_steps": Fault(
        "input and prediction",
        "drop agents beyond 30 + scale predictions 0.7",
        within_30_m,
        partial(slower, share=0.7),
    ),
    "old_and_small": Fault(
        "input",
        "delay agents 4 + scale agents' size 0.8",
        partial(older, count=4),
        partial(sized, share=0.8),
    ),
    "ahead_no_pedestrians": Fault(
        "input",
        f"shift agents ahead 0.5 + {NO_PEDESTRIANS}",
        no_pedestrians,
        partial(beside_ego, offset=0.5),
    ),
    "forgets_and_all_stand": Fault(
        "input and prediction", "no previous plan + scale predictions 0", stands, forgetful
    ),
    "slow_and_green": Fault(
        "input", "scale own speed 0.9 + lights green", partial(slow_ego, share=0.9), all_green
    ),
}
"""By name; a fifth of them in two parts."""


class Planted:
    """`dp_qp` behind a fault of `FAULTS`."""

    def __init__(self, context: PlannerContext, *, fault: str) -> None:
        self._fault = FAULTS[fault]
        config = strict(DpQpConfig, nested(self._fault.settings))
        changed = self._fault.context(context) if self._fault.context else context
        self._planner = DpQp(changed, config)
        self._frames: deque[Frame] = deque(maxlen=32)

    def plan(self, frame: Frame) -> Plan:
        """The plan of the changed frame, or the changed plan."""
        self._frames.append(frame)
        for edit in self._fault.edits:
            frame = edit(frame, self._before)
        plan = self._planner.plan(frame)
        return self._fault.plan(plan) if self._fault.plan else plan

    def _before(self, count: int) -> Frame:
        return self._frames[max(0, len(self._frames) - 1 - count)]


NAME = "studies.planted_inputs:Planted"


def answer(fault: Fault, result: Attribution) -> str:
    """Whether the answer is "right", "wrong" or "open"."""
    named = [result.best, *result.others] if result.best else []
    options = [{str(change) for change in tried.changes} for tried in named]
    options.append({words.split(" is ")[0] for words in result.settings})
    is_right = fault.changes in options or (not fault.changes and result.stage is not None)
    if is_right and set(result.cause.split(" and ")) == set(fault.cause.split(" and ")):
        return "right"
    return "wrong" if result.best or result.settings or not result.cause else "open"


def driven(name: str, out: Path, workers: int, suite: str | None = None) -> Results:
    """The run of a fault, or of `dp_qp` as it is, into the folder of this name."""
    fault = FAULTS.get(name)
    changes = fault.run if fault else {}
    spec = NAME if fault and not changes else "dp_qp"
    table = {"planners": [spec], "mode": "closed", "recording": False, **changes}
    if fault:
        table["loop"] = {**changes.get("loop", {}), "apart": {"trust": True}}
    if spec == NAME:
        table["planner"] = {NAME: {"fault": name}}
    return evaluate_logs(run=load_run(None, table), out=out / name, suite=suite, workers=workers)


def row(name: str, faulty: Results, baseline: Results) -> dict[str, Any]:
    """What came of a fault."""
    begin = perf_counter()
    result = attribute(Pair.of(faulty, baseline))
    return {
        "fault": name,
        "answer": answer(FAULTS[name], result),
        "seconds": round(perf_counter() - begin, 1),
        "said": " ".join(result.lines()),
    }


def main(words: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=list(FAULTS), default=list(FAULTS))
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(words)
    baseline = driven("baseline", options.out, options.workers)
    rows = []
    for name in options.only:
        rows.append(row(name, driven(name, options.out, options.workers), baseline))
        sys.stdout.write(f"{rows[-1]}\n")
        sys.stdout.flush()
        pd.DataFrame(rows).to_csv(options.out / "planted_inputs.csv", index=False)


if __name__ == "__main__":
    main()
