"""Answers replan's messages with an `AbstractPlanner`.

A drive has one planner: it is built and initialised at `hello` (networks load their checkpoint
there), and gets a history of 22 entries at each frame, as in nuPlan: 21 of the past and the
present. What it prints goes to stderr.

With `fresh` in its table, a frame without a previous plan (each one in open loop, the first one in
closed loop) is planned by a copy of the planner as it was initialised; so it remembers nothing of
other frames, and loads its checkpoint once.
"""

from __future__ import annotations

import copy
import gc
import importlib
import traceback
from collections import deque
from typing import Any

from nuplan.common.actor_state.state_representation import StateSE2
from nuplan.planning.simulation.history.simulation_history_buffer import SimulationHistoryBuffer
from nuplan.planning.simulation.planner.abstract_planner import PlannerInitialization, PlannerInput
from nuplan.planning.simulation.simulation_time_controller.simulation_iteration import (
    SimulationIteration,
)

from .nuplan_channel import Message, MessageChannel, points
from .nuplan_faults import called, describe
from .nuplan_plans import plan_message
from .nuplan_states import Converter
from .road_end import with_road_beyond
from .road_map import RoadMap

STEPS, STEP_S = 22, 0.1
PAST_S = 2.1
SAME_S = 1e-6
OWN_KEYS = ("python", "path", "hydra", "fresh")
"""Keys of a planner's table that are not keywords of its class."""


class DrivenScenario:
    """What a planner with `requires_scenario` gets: logs of replan have no type of nuPlan's. No
    dataclass, which hydra would convert to a dictionary.
    """

    scenario_type = "unknown"


class NuplanDrive:
    """One drive of a planner."""

    def __init__(self, target: str, hello: Message) -> None:
        context = with_road_beyond(hello["context"])
        self._map = RoadMap(context)
        self._converter = Converter(context, self._map.number)
        self._known: deque[tuple[float, Any, Any]] = deque()
        self._classes: dict[str, str] = {}  # of objects, by id
        self._start, self._period = context["start"]["t"], context["period"]
        self._is_fresh = hello["config"].get("fresh", False)
        planner = called("its constructor", built, target, hello["config"])
        route = (self._map.lanes.get(lane) for lane in context["route"]["lanes"])
        blocks = dict.fromkeys(lane.get_roadblock_id() for lane in route if lane is not None)
        initialization = PlannerInitialization(list(blocks), _goal_of(context), self._map)
        called("initialize", planner.initialize, initialization)
        self._planner = self._initialised = planner

    def plan(self, frame: Message) -> Message:
        """The plan of a frame."""
        for snapshot in sorted(frame.get("earlier", []), key=lambda item: item["t"]):
            self._remember(snapshot)
        self._remember(frame)
        entries = self._history(frame["t"])
        history = SimulationHistoryBuffer(
            deque((ego for _, ego, _ in entries), maxlen=STEPS),
            deque((seen for _, _, seen in entries), maxlen=STEPS),
            sample_interval=STEP_S,
        )
        converter = self._converter
        index = round((frame["t"] - self._start) / self._period)
        iteration = SimulationIteration(converter.time(frame["t"]), max(index, 0))
        lights = converter.lights(frame["t"], frame["lights"])
        if self._is_fresh and frame["previous"] is None:
            self._planner = called("its copy (fresh)", copy.deepcopy, self._initialised)
        planner_input = PlannerInput(iteration, history, lights)
        trajectory = called(
            "compute_planner_trajectory", self._planner.compute_trajectory, planner_input
        )
        gc.enable()  # PDM turns it off in each plan
        return plan_message(trajectory, frame, converter)

    def _remember(self, snapshot: Message) -> None:
        self._classes.update(snapshot.get("object_classes", {}))
        seen = self._converter.observation(snapshot["t"], snapshot["agents"], self._classes)
        self._known.append((snapshot["t"], self._converter.ego(snapshot["ego"]), seen))

    def _history(self, now: float) -> list[tuple[float, Any, Any]]:
        """The entries at steps of 0.1 s, the last known one up to each, oldest first."""
        known = self._known
        while len(known) > 1 and known[1][0] <= now - PAST_S + SAME_S:
            known.popleft()
        times = [now - STEP_S * k for k in range(STEPS - 1, -1, -1)]
        return [
            next((item for item in reversed(known) if item[0] <= t + SAME_S), known[0])
            for t in times
        ]


def built(target: str, config: Message) -> Any:
    """The planner "module:Class": from a hydra file (`hydra` in its table) with the other keys of
    its table in place of those of the file, else with them as keywords.
    """
    module, name = target.split(":")
    kind = getattr(importlib.import_module(module), name)
    keywords = {key: value for key, value in config.items() if key not in OWN_KEYS}
    more: dict[str, Any] = {}
    if kind.requires_scenario and "scenario" not in keywords:
        more["scenario"] = DrivenScenario()
    if "hydra" not in config:
        return kind(**keywords, **more)
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    tree = OmegaConf.load(config["hydra"])
    table = tree if "_target_" in tree else next(iter(tree.values()))
    return instantiate(OmegaConf.merge(table, keywords), **more)


def _goal_of(context: Message) -> StateSE2:
    """The middle of the goal's first region; the end of the route, or the start, without one."""
    goal, start = context["goal"], context["start"]
    regions = goal["regions"] if goal else []
    if not regions:
        return StateSE2(start["x"], start["y"], start["yaw"])
    x, y = points(regions[0]).mean(axis=0).tolist()
    return StateSE2(x, y, start["yaw"])


def serve(target: str) -> None:
    """Answer messages until replan closes the channel."""
    channel = MessageChannel.of_process()
    drive: NuplanDrive | None = None
    while True:
        message = channel.receive()
        if message is None:
            return
        is_hello = message["type"] == "hello"
        try:
            if is_hello:
                drive = NuplanDrive(target, message)
                answer = {"type": "ready", "schema": 1, "past_s": PAST_S}
            else:
                assert drive is not None, "a frame came before hello"
                answer = drive.plan(message)
        except Exception as error:
            traceback.print_exc()
            what = "build" if is_hello else "raised"
            answer = {"type": "failed", "message": describe(error), "what": what}
        channel.send(answer)
