"""The contracts of planners, metrics and readers, as checks for their authors:
`replan.check_planner` and the like.

Each check returns None, or raises one `ContractError` that names every broken rule, where it was
broken first, and the remedy. The rules are those of `replan.planners.base`, `replan.metrics.metric`
and `replan.logs.readers.base`; a rule that can only be examined where another holds (equal plans
without memory: deterministic) is examined only there.

A check runs the code in this process, without the limits in time and memory that a run has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from itertools import zip_longest
from math import hypot, inf, isfinite
from os.path import commonpath
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np

from replan.core.errors import ConfigError, LogError, PlannerError, ReplanError, raised
from replan.core.files import local_path
from replan.logs.catalogue import scenario as catalogue_scenario
from replan.logs.frame import PLAN_HORIZON_S, Frame, PlannerContext
from replan.logs.plan import Plan, PlanStart, PlanStatus
from replan.logs.readers import READER, LogSettings, Reader, read_log
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS
from replan.logs.trace import EndReason, Mode, Trace
from replan.logs.tracks import Tracks
from replan.metrics import load_metric
from replan.metrics.arrival import goal_of
from replan.metrics.metric import Metric, Series, Unavailable
from replan.planners.base import Planner
from replan.replay.drive import Drive
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop.plan_check import START_M, START_MPS, SWING_MPS, checked
from replan.replay.loop.planning import Planning, Seat
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import Factory
from replan.replay.perception import Perception
from replan.replay.planner_process.coordinates import (
    built,
    context_in_map,
    coordinates_of,
    frame_in_map,
)
from replan.replay.planner_process.planner_config import of_class, planner_part
from replan.replay.world import World, logged_ego

PLANNER_RULES: Mapping[str, str] = {
    "build": "Class(context) builds a planner: give every other argument a default",
    "answer": (
        "return a Plan at every frame; if there is none, a fallback with its status and a reason"
    ),
    "time": "begin the trajectory at frame.t",
    "start": (
        "begin in the ego's state, or with PlanStart.PREVIOUS_PLAN in "
        "frame.previous.trajectory.at(frame.t)"
    ),
    "horizon": "plan for at least context.horizon",
    "reason": "say in `reason` why the plan is a fallback",
    "columns": "compute speed, heading, curvature and acceleration of the positions",
    "drivable": "plan what a car can drive",
    "frame": "copy the frame's arrays before changing them",
    "deterministic": "use no clock, and no random numbers without a seed",
    "memory": "use nothing of earlier frames where frame.previous is None",
    "future": "use the frame and the context only",
    "batch": "return a list from plan_batch: a plan for each frame",
}
"""The rules for planners, with their remedies."""
METRIC_RULES: Mapping[str, str] = {
    "answer": "return a Series, Unavailable, or a mapping from parts to these",
    "modes": "declare only the modes in which it is defined",
    "parts": "return the parts that the metric declares",
    "reason": "say in Unavailable(reason) or Series(missing=) why there is no value",
    "needs": "name in `needs` what the log or drive must contain",
    "times": "give each step a time of the drive, in increasing order",
    "finite": "return Unavailable, or NaN for a step, where there is no value",
    "inputs": "copy arrays of the trace and the scenario before changing them",
    "pure": "use no clock, no random numbers, and no memory of other drives",
}
"""The rules for metrics, likewise."""
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
"""The rules for readers, likewise."""
SCENARIOS = (
    "paper/free_road",
    "paper/crossing_pedestrian",
    "everyday/follow",
    "everyday/cut_in",
    "everyday/traffic_light",
    "everyday/junction",
)
"""The scenarios of the catalogue on which planners and metrics are checked by default."""
SHARES = (0.0, 0.35, 0.7)
"""The frames that are examined one by one, as shares of the logged drive."""
CLOSED_S = 2.0
"""Length of the closed loop, s."""
ROUNDING = 1e-9
"""A solver that was set up by another problem rounds otherwise."""
_CONFIG = LoopConfig(perception="ground_truth")

T = TypeVar("T")


class ContractError(ReplanError):
    """A planner, metric or reader breaks rules of its contract; the message has a line for each.

    Attributes:
        broken: The names of the broken rules.
    """

    def __init__(self, subject: str, breaches: Mapping[str, str]) -> None:
        self.broken = tuple(breaches)
        lines = [f"- {rule}: {text}" for rule, text in breaches.items()]
        super().__init__("\n".join([f"{subject} breaks its contract:", *lines]))


class _Findings:
    """The first breach of each rule."""

    def __init__(self, rules: Mapping[str, str]) -> None:
        self._rules, self.breaches = rules, dict[str, str]()

    def add(self, rule: str, where: str, breach: str) -> None:
        self.breaches.setdefault(rule, f"{where}: {breach}; {self._rules[rule]}")

    def report(self, subject: str) -> None:
        """Raise the ContractError, with the rules in the order of their table, if any is broken."""
        if self.breaches:
            raise ContractError(
                subject,
                {rule: self.breaches[rule] for rule in self._rules if rule in self.breaches},
            )


def _call(
    findings: _Findings, rule: str, where: str, function: Callable[..., T], *arguments: Any
) -> T | None:
    """Call a function of the user's; None if it raises, which breaks the rule."""
    try:
        return function(*arguments)
    except (Exception, SystemExit) as error:
        findings.add(rule, where, f"it raised {raised(error, of=function)}")
        return None


def _difference(first: object, second: object) -> str:
    """Return the first place where two things differ ("agents.x"), or "": equal to the bit."""
    for a, b in zip_longest(_leaves(first), _leaves(second)):
        if a != b:
            return (a or b or ("",))[0] or "itself"
    return ""


def _leaves(thing: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield all numbers, texts and arrays within a thing, with their places."""
    if isinstance(thing, np.ndarray) and thing.dtype != object:
        yield path, (thing.shape, thing.dtype.str, thing.tobytes())
    elif is_dataclass(thing) and not isinstance(thing, type):
        for field in fields(thing):
            yield from _leaves(getattr(thing, field.name, None), f"{path}.{field.name}".lstrip("."))
    elif isinstance(thing, Mapping):
        for key, value in thing.items():
            yield from _leaves(value, f"{path}[{key!r}]")
    elif isinstance(thing, Sequence) and not isinstance(thing, str | bytes):
        yield path, len(thing)
        for k, value in enumerate(thing):
            yield from _leaves(value, f"{path}[{k}]")
    elif isinstance(thing, float | np.floating):
        yield path, float(thing).hex()
    else:
        yield (
            path,
            thing
            if isinstance(thing, str | bytes | int | Enum | None)
            else type(thing).__qualname__,
        )


def _scenarios(scenarios: Iterable[Scenario] | None) -> list[Scenario]:
    return (
        [catalogue_scenario(name) for name in SCENARIOS] if scenarios is None else list(scenarios)
    )


# planners -----------------------------------------------------------------------------------------

Build = Callable[[Scenario], Planner]
"""Builds a planner for a scenario; one that is no oracle uses only its `context_of`."""


def check_planner(planner: Factory | str, *, scenarios: Iterable[Scenario] | None = None) -> None:
    """Check the contract of a planner: at single frames with a new memory, and in closed loop.

    The rules are those of `replan.contract.PLANNER_RULES`.

    Args:
        planner: The class, a function that builds a planner from the context, a name, or
            "module:Class".
        scenarios: The scenarios to plan in; None: some of the catalogue.

    Raises:
        ContractError: A rule is broken.
        ConfigError: No planner has this name, or it is a program.
        PlannerError: The planner cannot be loaded.
    """
    factory = planner_part(planner).factory if isinstance(planner, str) else planner
    findings = _Findings(PLANNER_RULES)
    prepare = of_class(factory, "prepare")
    if prepare is not None:
        prepare()
    for scenario in _scenarios(scenarios):
        _check_frames(factory, scenario, findings)
        # With these no drive goes on
        if not {"build", "answer", "time", "reason"} & findings.breaches.keys():
            _check_closed_loop(factory, scenario, findings)
            _check_batch(factory, scenario, findings)
    findings.report(f"planner {_name_of(planner)}")


def _name_of(extension: object) -> str:
    return (
        extension
        if isinstance(extension, str)
        else getattr(extension, "__qualname__", repr(extension))
    )


def context_of(scenario: Scenario) -> PlannerContext:
    """Return the context of a planner for a scenario."""
    start = logged_ego(scenario.ego, scenario.vehicle, float(scenario.ego.t[0]))
    return PlannerContext(
        scenario.road,
        goal_of(scenario)[0],
        scenario.vehicle,
        _CONFIG.plan_period_s,
        start,
        origin=scenario.origin,
    )


def frame_of(scenario: Scenario, t: float) -> Frame:
    """Return the frame at a time of the logged drive, without a previous plan."""
    world = World(logged_ego(scenario.ego, scenario.vehicle, t), scenario.tracks)
    return Perception(scenario, _CONFIG).frame(world, None)


def frame_times_of(scenario: Scenario) -> list[float]:
    """Return the times of the frames that are examined one by one."""
    first, last = float(scenario.ego.t[0]), float(scenario.ego.t[-1])
    return [round(first + share * (last - first), 2) for share in SHARES]


def until(tracks: Tracks, t: float) -> Tracks:
    """Return the tracks cut at a time: no later sample, and no agent that appears later."""
    keep = tracks.t <= t + 1e-9
    first = tracks.offsets[:-1][tracks.static]
    keep[first] = True
    return tracks.taken(keep)


def _check_frames(factory: Factory, scenario: Scenario, findings: _Findings) -> None:
    """Check the rules about single frames; the frames of one planner follow each other."""

    def build(seen_scenario: Scenario) -> Planner:
        return built(factory, context_of(seen_scenario))

    first, second = (_call(findings, "build", scenario.name, build, scenario) for _ in range(2))
    if first is None or second is None:
        return
    for t in frame_times_of(scenario):
        where = f"{scenario.name}, {t:.2f} s"
        frame, again = frame_of(scenario, t), frame_of(scenario, t)
        plan = _call(findings, "answer", where, first.plan, frame)
        check_plan(plan, frame, where, findings)
        changed = _difference(frame, again)
        if changed:
            findings.add("frame", where, f"it changed frame.{changed}")
        other = _call(findings, "answer", where, second.plan, again)
        if changed or not isinstance(plan, Plan) or not isinstance(other, Plan):
            return
        differs = _plans_differ(plan, other)
        if differs:
            findings.add(
                "deterministic", where, f"two planners with the same frames differ: {differs}"
            )
        if "deterministic" not in findings.breaches:
            new = _call(findings, "memory", where, _plan_anew, build, scenario, t)
            differs = _plans_differ(plan, new, ROUNDING) if new else ""
            if differs:
                findings.add(
                    "memory",
                    where,
                    f"a planner that saw earlier frames and a new one differ: {differs}",
                )
            changes = _call(findings, "future", where, future_changes, build, scenario, t)
            if changes:
                findings.add(
                    "future", where, f"samples of agents after the frame change the plan: {changes}"
                )


def _plan_anew(build: Build, scenario: Scenario, t: float) -> Plan:
    return build(scenario).plan(frame_of(scenario, t))


def future_changes(build: Build, scenario: Scenario, t: float) -> str:
    """Return how samples of agents later than `t` change the plan at `t`; "" if they do not."""
    without = replace(scenario, tracks=until(scenario.tracks, t))
    return _plans_differ(_plan_anew(build, scenario, t), _plan_anew(build, without, t))


def _plans_differ(first: Plan, second: Plan, tolerance: float = 0.0) -> str:
    """Return how two plans differ by more than the tolerance, or ""."""
    if first.status is not second.status:
        return f"the plans are '{first.status.value}' and '{second.status.value}'"
    a, b = first.trajectory, second.trajectory
    if len(a) != len(b):
        return f"the plans have {len(a)} and {len(b)} states"
    worst = {
        name: float(np.max(np.abs(getattr(a, name) - getattr(b, name))))
        for name in TRAJECTORY_COLUMNS
    }
    name = next((name for name, largest in worst.items() if largest > tolerance), "")
    return f"{name} by up to {worst[name]:.3g}" if name else ""


def check_plan(plan: object, frame: Frame, where: str, findings: _Findings) -> None:
    """Check what holds for every plan.

    A trajectory is finite and its times increase (`Trajectory`).
    """
    if not isinstance(plan, Plan):
        findings.add("answer", where, f"it returned {type(plan).__name__}")
        return
    trajectory = plan.trajectory
    if abs(float(trajectory.t[0]) - frame.t) > 1e-6:
        findings.add("time", where, f"the trajectory begins at {trajectory.t[0]:.2f} s")
        return
    if plan.status.is_fallback and not plan.reason:
        findings.add("reason", where, f"the status is '{plan.status.value}', without a reason")
    begins, on = frame.ego, "the ego"
    if plan.start is PlanStart.PREVIOUS_PLAN:
        if frame.previous is None:
            findings.add("start", where, "it starts on a previous plan, and there is none")
            return
        begins, on = frame.previous.trajectory.at(frame.t), "the previous plan"
    away, faster = (
        hypot(trajectory.x[0] - begins.x, trajectory.y[0] - begins.y),
        float(trajectory.v[0]) - begins.v,
    )
    # As `replan.replay.loop.plan_check` (1)
    stopped = trajectory.v[0] == 0.0 and -SWING_MPS <= begins.v < 0.0
    if away > START_M or (abs(faster) > START_MPS and not stopped):
        findings.add("start", where, f"it starts {away:.2f} m and {faster:+.2f} m/s off {on}")
        return
    if trajectory.t[-1] < frame.t + PLAN_HORIZON_S - 1e-6:
        findings.add("horizon", where, f"the plan ends after {trajectory.t[-1] - frame.t:.2f} s")
    driven = checked(plan, frame)
    if driven.status is not plan.status:
        rule = "columns" if driven.status is PlanStatus.CORRECTED else "drivable"
        findings.add(rule, where, driven.reason)


class _WatchedPlanner:
    """A planner whose plans are checked as it makes them."""

    def __init__(self, planner: Planner, name: str, findings: _Findings) -> None:
        self._planner, self._name, self._found = planner, name, findings

    def plan(self, frame: Frame) -> Plan:
        plan = self._planner.plan(frame)
        check_plan(plan, frame, f"{self._name}, closed loop, {frame.t:.2f} s", self._found)
        return plan


def _check_closed_loop(factory: Factory, scenario: Scenario, findings: _Findings) -> None:
    class Seat(Planning):
        """Calls the planner that is checked."""

        def __init__(self, *arguments: Any, **keywords: Any) -> None:
            super().__init__(*arguments, **keywords)
            self._planner = _WatchedPlanner(built(factory, self.context), scenario.name, findings)

    before = dict(findings.breaches)
    trace = run_closed_loop(
        scenario, "constant_speed", config=_CONFIG, until_s=CLOSED_S, seat=Seat
    ).trace
    if trace.end is EndReason.PLANNER_FAILURE and findings.breaches == before:
        findings.add("answer", f"{scenario.name}, closed loop", trace.detail)


def _check_batch(factory: Factory, scenario: Scenario, findings: _Findings) -> None:
    """Check that `plan_batch`, if there is one, plans each of two frames."""
    together = of_class(factory, "plan_batch")
    if together is None:
        return
    frames = [frame_of(scenario, t) for t in frame_times_of(scenario)[:2]]
    context = context_of(scenario)
    if coordinates_of(factory) == "map":
        frames = [frame_in_map(frame, context.origin) for frame in frames]
        context = context_in_map(context)
    where = f"{scenario.name}, plan_batch of {len(frames)} frames"
    plans = _call(findings, "batch", where, together, frames, [factory(context) for _ in frames])
    if plans is None:
        return
    if not isinstance(plans, list) or len(plans) != len(frames):
        findings.add(
            "batch", where, f"it returned {type(plans).__name__}, not a list of {len(frames)} plans"
        )
        return
    for plan, frame in zip(plans, frames, strict=True):
        check_plan(plan, frame, f"{where}, {frame.t:.2f} s", findings)


# metrics ------------------------------------------------------------------------------------------

MetricDrive = tuple[Trace, Scenario]
Loop = Callable[..., Drive]


def check_metric(metric: Metric | str, *, scenarios: Iterable[Scenario] | None = None) -> None:
    """Check the contract of a metric: on drives in its modes, among them some that hardly are any.

    The rules are those of `replan.contract.METRIC_RULES`.

    Args:
        metric: The metric, its name, or "module:NAME".
        scenarios: The scenarios to drive in; None: some of the catalogue.

    Raises:
        ContractError: A rule is broken.
        ConfigError: The metric cannot be loaded.
    """
    check_metric_on(
        load_metric(metric) if isinstance(metric, str) else metric,
        metric_drives(_scenarios(scenarios)),
    )


def metric_drives(scenarios: Iterable[Scenario]) -> list[MetricDrive]:
    """Return drives of `constant_speed` in both modes: whole ones, and ones that lack what a metric
    may need.
    """
    drives: list[MetricDrive] = []

    def drive(run: Loop, log: Scenario, seat: Seat = Planning, until_s: float = inf) -> None:
        copy = replace(log)  # a metric that writes does not reach the caller's
        drives.append(
            (run(copy, "constant_speed", config=_CONFIG, seat=seat, until_s=until_s).trace, copy)
        )

    for k, scenario in enumerate(scenarios):
        bare = replace(scenario, tracks=Tracks.empty(), goal=None, lights=())
        path = replace(bare, road=replace(bare.road, source=RoadSource.DRIVEN_PATH))
        for run in (run_open_loop, run_closed_loop):
            drive(run, scenario)
            if k == 0:
                drive(run, path, until_s=1.0)
                drive(run, scenario, _failing(0.0))  # no plan
                drive(run, scenario, _failing(0.1))  # one plan
    return drives


def _failing(at_s: float) -> Seat:
    """Return the seat of a planner that fails at a time."""

    class Failing(Planning):
        """Raises from `at_s` on."""

        def plan(self, frame: Frame) -> Plan:
            """As `Planning.plan`."""
            if frame.t >= at_s - 1e-9:
                raise PlannerError("the planner failed")
            return super().plan(frame)

    return Failing


def check_metric_on(metric: Metric, drives: Sequence[MetricDrive]) -> None:
    """Check a metric on drives, and once more in reverse order on copies.

    Raises:
        ContractError: A rule is broken.
    """
    findings = _Findings(METRIC_RULES)
    judged = [(trace, scenario) for trace, scenario in drives if trace.mode in metric.modes]
    results, failed = list[object](), dict[Mode, dict[str, str]]()
    for trace, scenario in judged:
        where = f"{scenario.name}, {trace.mode.value} loop, {len(trace.frames)} plans"
        before = [*_leaves((trace, scenario))]
        try:
            measured = metric.measure(trace, scenario)
        except (Exception, SystemExit) as error:
            failed.setdefault(trace.mode, {})[where] = (
                f"it raised {raised(error, of=metric.measure)}"
            )
            measured = None
        else:
            _check_measured(metric, measured, trace, where, findings)
        if before != [*_leaves((trace, scenario))]:
            findings.add("inputs", where, "it changed the trace or the scenario")
        results.append(measured)
    for mode, places in failed.items():
        never = len(failed) < len(metric.modes) and len(places) == sum(
            trace.mode is mode for trace, _ in judged
        )
        findings.add("modes" if never else "answer", *next(iter(places.items())))
    if not {"answer", "modes", "inputs"} & findings.breaches.keys():
        for (trace, scenario), first in zip(reversed(judged), reversed(results), strict=True):
            where = f"{scenario.name}, {trace.mode.value} loop"
            again = _call(
                findings, "pure", where, metric.measure, replace(trace), replace(scenario)
            )
            differs = _difference(first, again)
            if differs:
                findings.add("pure", where, f"measured twice, it differs in {differs}")
    findings.report(f"metric {metric.name}")


def _check_measured(
    metric: Metric, measured: object, trace: Trace, where: str, findings: _Findings
) -> None:
    parts: Mapping[Any, object] = measured if isinstance(measured, Mapping) else {"": measured}
    strange = set(parts) - set(metric.parts) if metric.parts != ("*",) else set()
    if isinstance(measured, Mapping) and strange:
        findings.add("parts", where, f"it returned the part {min(map(repr, strange))}")
    if isinstance(measured, Series) and metric.parts:
        findings.add("parts", where, "it returned one series")
    for part, answer in parts.items():
        which = f"{where}, part {part}" if part else where
        if isinstance(answer, Series):
            _check_series(metric, answer, trace, which, findings)
        elif not isinstance(answer, Unavailable):
            findings.add("answer", which, f"it returned {type(answer).__name__}")
        elif not isinstance(answer.reason, str) or not answer.reason.strip():
            findings.add("reason", which, "it is unavailable without a reason")
        elif not metric.needs:
            findings.add("needs", which, f"it is unavailable: {answer.reason}")


def _check_series(
    metric: Metric, series: Series, trace: Trace, where: str, findings: _Findings
) -> None:
    first, last = float(trace.ego.t[0]), float(trace.ego.t[-1])
    if series.t[0] < first - 1e-6 or series.t[-1] > last + 1e-6 or (np.diff(series.t) <= 0.0).any():
        findings.add(
            "times",
            where,
            f"its times are {series.t[0]:.2f} to {series.t[-1]:.2f} s, the drive's {last:.2f} s",
        )
    if not series.known.any():
        if not series.missing.strip():
            findings.add("reason", where, "no step has a value, and `missing` is empty")
        elif not metric.needs and any(reduction.empty is None for reduction in metric.reductions):
            findings.add("needs", where, f"it is unavailable: {series.missing}")
        return
    for reduction in metric.reductions:
        reduced = _call(findings, "answer", f"{where}, {reduction.name}", reduction.reduce, series)
        if reduced is not None:
            value, step = reduced
            if not isfinite(value) or not -1 <= step < len(series.t):
                findings.add("finite", where, f"{reduction.name} is {value} at step {step}")


# readers ------------------------------------------------------------------------------------------

MOST_DAMAGED = 8
"""Of a log of many files, the number of those that are damaged in turn."""


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
    path, settings, findings = local_path(path), settings or LogSettings(), _Findings(READER_RULES)
    beside = _entries(path)
    claimed = _call(findings, "claims", path.name, reader.claims, path)
    if claimed is False and not reader.claims_with(path, settings):
        findings.add("claims", path.name, "it does not claim the log")
    files = _call(findings, "files", path.name, reader.files, path) or ()
    if not files or not all(file.is_file() for file in files) or reader.files(path) != files:
        findings.add(
            "files",
            path.name,
            f"its {len(files)} files do not all exist, or differ when asked again",
        )
        files = ()
    _call(findings, "contents", path.name, reader.contents, path)
    _check_read(reader, path, settings, findings)
    with TemporaryDirectory() as folder:
        _check_foreign(reader, Path(folder), findings)
    for file in files[:: max(1, len(files) // MOST_DAMAGED)]:
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


def _check_read(reader: Reader, path: Path, settings: LogSettings, findings: _Findings) -> None:
    with np.errstate(all="ignore"):  # as `read_log`
        scenario = _call(findings, "read", path.name, reader.read, path, settings)
        if scenario is None or not isinstance(scenario, Scenario):
            findings.add("read", path.name, f"it returned {type(scenario).__name__}")
            return
        differs = _difference(
            scenario, _call(findings, "same", path.name, reader.read, path, settings)
        )
    if differs:
        findings.add("same", path.name, f"read twice, it differs in {differs}")
    _call(findings, "admitted", path.name, lambda: read_log(path, settings, reader))


def _check_foreign(reader: Reader, folder: Path, findings: _Findings) -> None:
    """Check that it claims no path of another kind."""
    (folder / "notes.of-no-format").write_bytes(b"no log\n")
    (folder / "empty").mkdir()
    for name in ("notes.of-no-format", "empty", "missing.of-no-format"):
        if _call(findings, "claims", name, reader.claims, folder / name):
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
    reader: Reader, path: Path, share: float, settings: LogSettings, findings: _Findings
) -> None:
    """Check what is raised for a damaged copy of the log, and that nothing is written beside it."""
    where, before = f"{path.name} with {share:.0%} of a file", _entries(path)
    _call(findings, "claims", where, reader.claims, path)
    _call(findings, "contents", where, reader.contents, path)
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
