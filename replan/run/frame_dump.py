"""One planning frame: as a file (input of the planner since the start of its drive, plan, QPs), and
planned again.

A dump is one MessagePack map with the fields of `File`. Context, frames and plan are the messages
of `replan.replay.planner_process.messages` (docs/bring_planner.md): little-endian float64 columns,
so that values are read back to the bit. A planner has memory, so a dump contains all frames up to
the one of interest; in open loop, where each frame starts with fresh memory, it contains only that
one.

    dump = load(Path("frame.msgpack"))
    dump.frame.agents.ids, dump.problems[0].lower
    assert (dump.planned().trajectory.x == dump.plan.trajectory.x).all()

`replan frame` plans a frame of a run again in this process: the drive up to it, its plan, times and
QPs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from replan.config import RunConfig
from replan.core.errors import ConfigError, LogError, PlannerError, ReplanError, of_users, raised
from replan.core.names import counted
from replan.draw.drawn_results import DriveResult
from replan.explain.causes import Explainer
from replan.explain.changed_frames import changed, changed_context
from replan.explain.explanation import Explanation, lines_of
from replan.explain.input_changes import InputChange
from replan.explain.planner_input import PlannerInput
from replan.logs.codec import WIRE, packed
from replan.logs.frame import Frame, PlannerContext
from replan.logs.past import PAST_S
from replan.logs.plan import Plan, SolverReport
from replan.logs.scenario import Scenario
from replan.logs.trace import Mode, PlannedFrame
from replan.planners.base import Planner
from replan.planners.piecewise_jerk.problem import PiecewiseJerkProblem, Weights
from replan.planners.piecewise_jerk.solvers import SolvedProblem, record_problems
from replan.planners.solver import QPResult
from replan.replay.drive import Drive, Stopwatch
from replan.replay.loop.plan_check import checked
from replan.replay.loop.planning import Planning
from replan.replay.parts import PLANNER
from replan.replay.planner_process import messages
from replan.replay.planner_process.coordinates import built
from replan.replay.planner_process.past_messages import ReceivedPast, SentPast
from replan.replay.planner_process.planner_config import is_foreign, planner_part
from replan.results.tables import write_file
from replan.run.one_log import LOOPS
from replan.run.output import scenario_of

VERSION = 1


class DumpedProblem(msgspec.Struct):
    """`replan.planners.piecewise_jerk.problem.PiecewiseJerkProblem`, and the curve x, x', x''
    `(3 n,)` that solves it.
    """

    report: SolverReport  # The solver's report; its stage names the caller
    numbers: list[float]  # step, soft, and the weights x, dx, ddx, dddx
    leads: bytes  # `(k,)`
    start: bytes  # `(3,)`
    references: bytes  # `(2, n)` row by row
    lower: bytes  # `(4 + k, n)` row by row; `upper` likewise
    upper: bytes
    x: bytes


class File(msgspec.Struct):
    """The contents of the file."""

    version: int
    log: str  # Name; `planner` and `config` (its table) are as in a run's configuration
    planner: str
    config: dict[str, Any]
    context: messages.Context  # The context with which the planner was built
    frames: list[messages.Frame]  # The frames in order of time; the last is the one of interest
    plan: messages.Plan  # The plan of the last frame, with its internals
    problems: list[DumpedProblem]  # The QPs that were solved for it, in their order


@dataclass(frozen=True, eq=False)
class FrameDump:
    """A dump as objects, with the attributes of `File`.

    The clock of the context measures nothing.
    """

    log: str
    planner: str
    config: Mapping[str, Any]
    context: PlannerContext
    frames: tuple[Frame, ...]
    plan: Plan
    problems: tuple[SolvedProblem, ...]

    @property
    def frame(self) -> Frame:
        """The frame of interest: the last one."""
        return self.frames[-1]

    def planned(self) -> Plan:
        """The plan made anew in this process, by a planner that gets all frames.

        Its errors are not caught.
        """
        planner = built(planner_part(self.planner, self.config).configured(), self.context)
        for frame in self.frames[:-1]:
            planner.plan(frame)
        plan = checked(planner.plan(self.frame), self.frame, self.context.origin)
        return plan.recorded(keep=True)


def dump(path: Path, frame_dump: FrameDump) -> None:
    """Write a dump; OutputError if the file cannot be written."""
    problems, sent_past = [], SentPast(PAST_S)
    for problem, result in frame_dump.problems:
        arrays = {
            name: packed(getattr(problem, name))
            for name in ("leads", "start", "references", "lower", "upper")
        }
        numbers = [problem.step, problem.soft, *problem.weights]
        problems.append(
            DumpedProblem(report=result.report, numbers=numbers, x=packed(result.x), **arrays)
        )
    file = File(
        version=VERSION,
        log=frame_dump.log,
        planner=frame_dump.planner,
        config=dict(frame_dump.config),
        context=messages.context_message(frame_dump.context),
        frames=[sent_past.message(frame) for frame in frame_dump.frames],
        plan=messages.plan_message(frame_dump.plan, inside=True),
        problems=problems,
    )
    data = messages.encode(file)
    write_file(path, lambda partial: partial.write_bytes(data))


def load(path: Path) -> FrameDump:
    """Read a dump; LogError if the file is damaged, or is not a dump."""
    try:
        file: File = messages.decode(path.read_bytes(), File)
        if file.version != VERSION:
            raise ValueError(f"a dump of version {file.version}, this replan reads {VERSION}")
        return FrameDump(
            log=file.log,
            planner=file.planner,
            config=file.config,
            context=messages.context_of(file.context, lambda stage: None),
            frames=tuple(map(ReceivedPast(PAST_S).frame, file.frames)),
            plan=messages.plan_of(file.plan),
            problems=tuple(map(_problem_of, file.problems)),
        )
    except (OSError, ValueError, KeyError, msgspec.MsgspecError) as error:
        raise LogError(f"is not a dump of a frame: {error}", file=path) from None


def _problem_of(message: DumpedProblem) -> SolvedProblem:
    step, soft, *weights = message.numbers
    columns = (
        message.leads,
        message.start,
        message.references,
        message.lower,
        message.upper,
        message.x,
    )
    leads, start, references, lower, upper, x = (
        np.frombuffer(column, WIRE).copy() for column in columns
    )
    problem = PiecewiseJerkProblem(
        step=step,
        leads=leads,
        start=start,
        weights=Weights(*weights),
        references=references.reshape(2, -1),
        lower=lower.reshape(4 + len(leads), -1),
        upper=upper.reshape(4 + len(leads), -1),
        soft=soft,
    )
    return SolvedProblem(problem, QPResult(x, message.report))


SAME_TIME_S = 1e-6


class _KeptAnswers:
    """A planner whose plans are kept."""

    def __init__(self, planner: Planner, answers: list[Plan]) -> None:
        self._planner, self._answers = planner, answers

    def plan(self, frame: Frame) -> Plan:
        """The plan of the planner."""
        plan = self._planner.plan(frame)
        if isinstance(plan, Plan):
            self._answers.append(plan)
        return plan


class WatchedPlanning(Planning):
    """A planning that keeps its frames, the planner's answers as they were before the check, and
    the QPs of the last.

    A debugger opens at the frame of `stop_s`.
    """

    def __init__(self, stop_s: float, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self.frames: list[Frame] = []
        self.answers: list[Plan] = []
        self._planner = _KeptAnswers(self._planner, self.answers)
        self.asked: list[SolvedProblem] = []
        self._stop_s = stop_s

    def plan(self, frame: Frame) -> Plan:
        """As `Planning.plan`."""
        self.frames.append(frame)
        if frame.t >= self._stop_s - SAME_TIME_S:
            breakpoint()
        with record_problems() as self.asked:
            return super().plan(frame)


@dataclass(frozen=True, eq=False)
class ReplannedFrame:
    """A frame planned again."""

    scenario: Scenario
    dump: FrameDump  # The frames up to it, the plan, the QPs
    seconds: Mapping[str, float]  # Duration of each stage, and "total", s
    # Whether the trajectory is the one in the results, to the bit: does the planner, or another one
    # with changed input, plan what was driven? None for another planner with the same input
    is_same: bool | None


def replan_frame(
    drive: DriveResult,
    at: float,
    planner: str | None = None,
    changes: Sequence[InputChange] = (),
    *,
    debug: bool = False,
) -> ReplannedFrame:
    """Drive up to a frame as the run did, in this process, and plan it again.

    `at`: time, s; the last frame that is not later is planned again. `planner`: another planner,
    which gets this frame only; None: the drive's own. `changes`: changes of the input; the planner
    then gets all frames up to this one, so changed. `debug`: open the debugger before the frame is
    planned. ConfigError if there is no such frame, the log was moved or changed, or the planner is
    a program or an oracle; PlannerError if the planner raised.
    """
    run, recorded = drive.result.run, drive.frame(at)
    for spec in (drive.planner, planner or drive.planner):
        if is_foreign(spec) or spec in PLANNER.oracles:
            raise ConfigError(
                f"planner '{spec}': only Python planners that are not oracles can plan a frame "
                "again"
            )
    scenario, table = scenario_driven(drive), run.planner.get(drive.planner, {})
    own_seat = planner is None and not changes
    debug_at = recorded.t if debug and own_seat else inf
    watch, drive_again = watched_drive(drive, scenario, run, recorded.t, debug_at)
    if not drive_again.trace.frames or not _is_at(drive_again.trace.frames[-1].t, recorded.t):
        reason = drive_again.trace.detail or drive_again.trace.end.value
        raise PlannerError(f"{drive.log}: there is no plan at {recorded.t:.2f} s: {reason}")
    if not own_seat:
        name = planner or drive.planner
        again = _plan_with(drive, scenario, watch, name, changes, debug=debug)
        same = _is_plan_of(again.dump.plan, recorded.plan) if changes else None
        return replace(again, is_same=same)
    last = watch.frames[-1]
    frames = tuple(watch.frames) if last.previous is not None else (last,)
    plan = drive_again.trace.frames[-1].plan
    dump = FrameDump(
        drive.log, drive.planner, table, watch.context, frames, plan, tuple(watch.asked)
    )
    seconds = {
        time.stage: time.seconds
        for time in drive_again.timings
        if abs(time.t - last.t) < SAME_TIME_S
    }
    return ReplannedFrame(scenario, dump, seconds, _is_plan_of(plan, recorded.plan))


def _is_plan_of(plan: Plan, recorded: Plan) -> bool:
    """Whether the trajectory is the one of the results, to the bit."""
    new, old = plan.trajectory, recorded.trajectory
    # A trace without internals has only every few samples
    rows = [int(abs(new.t - t).argmin()) for t in old.t]
    return all(
        (getattr(new, name)[rows] == getattr(old, name)).all()
        for name in ("x", "y", "yaw", "v", "a")
    )


def _is_at(t: float, other: float) -> bool:
    return abs(t - other) <= SAME_TIME_S


def scenario_driven(drive: DriveResult) -> Scenario:
    """The log of a drive, with the vehicle of its run; errors as `scenario_of`."""
    run, row = drive.result.run, drive.result.logs.set_index("log").loc[drive.log].to_dict()
    scenario = scenario_of(drive.result.path, row, run.log)
    return scenario.in_vehicle(run.driven(scenario.vehicle))


def watched_drive(
    drive: DriveResult, scenario: Scenario, run: RunConfig, until_s: float, debug_at: float = inf
) -> tuple[WatchedPlanning, Drive]:
    """The drive up to a time, s, again, in this process and with the settings of `run`.

    ConfigError and PlannerError as `replan.replay.loop.closed_loop.run_closed_loop`.
    """
    seats = list[WatchedPlanning]()

    def seat(*arguments: Any, **keywords: Any) -> WatchedPlanning:
        seats.append(WatchedPlanning(debug_at, *arguments, **keywords))
        return seats[0]

    keywords = planner_part(drive.planner, run.planner.get(drive.planner, {})).keywords()
    config = replace(run.drive_loop, apart=replace(run.loop.apart, trust=True))
    loop = LOOPS[Mode(drive.mode)]
    again = loop(
        scenario, drive.planner, planner_config=keywords, config=config, until_s=until_s, seat=seat
    )
    return seats[0], again


def _plan_with(
    drive: DriveResult,
    scenario: Scenario,
    watch: WatchedPlanning,
    planner: str,
    changes: Sequence[InputChange],
    *,
    debug: bool,
) -> ReplannedFrame:
    """Plan the last frame with a new instance of a planner, which gets it alone; with changes, all
    frames.
    """
    clock = Stopwatch()
    context = changed_context(replace(watch.context, lap=clock.lap), changes)
    frames = tuple(changed(watch.frames, changes)) if changes else (watch.frames[-1],)
    frames = (replace(frames[0], previous=None), *frames[1:])
    driven = watch.frames[-1] if changes else frames[-1]  # the loop checks a plan against it
    table = drive.result.run.planner.get(planner, {})
    build = planner_part(planner, table).configured()
    try:
        instance = built(build, context)
        for frame in frames[:-1]:
            instance.plan(frame)
        if debug:
            breakpoint()
        with record_problems() as problems:
            clock.start()
            plan = checked(instance.plan(frames[-1]), driven, context.origin).recorded(keep=True)
            clock.stop(frames[-1].t)
    except Exception as error:
        if isinstance(error, ReplanError) or not of_users(error):
            raise
        raise PlannerError(
            f"planner '{planner}' raised at {frames[-1].t:.2f} s: {raised(error)}"
        ) from error
    dump = FrameDump(drive.log, planner, table, context, frames, plan, tuple(problems))
    last = {time.stage: time.seconds for time in clock.times if _is_at(time.t, frames[-1].t)}
    return ReplannedFrame(scenario, dump, last, None)


def report_of(again: ReplannedFrame) -> Iterator[str]:
    """The report for debugging the frame."""
    dump, frame, plan = again.dump, again.dump.frame, again.dump.plan
    yield (
        f"{dump.log}, {dump.planner}, frame at {frame.t:.3f} s ({len(dump.frames)} since the "
        "planner was built)"
    )
    if again.is_same is not None:
        yield "  the plan is the one in the results" + (
            ", to the bit" if again.is_same else ": NO, it is another"
        )
    futures = frame.predictions
    yield (
        f"  ego {frame.ego.x:.2f}, {frame.ego.y:.2f} m, {frame.ego.v:.2f} m/s, {frame.ego.a:.2f} "
        f"m/s²; {counted(len(frame.agents), 'agent')}, {counted(len(futures), 'prediction')} of "
        f"{counted(len(futures.t), 'sample')} ({futures.method})"
    )
    stages = ", ".join(f"{stage} {1e3 * seconds:.2f}" for stage, seconds in again.seconds.items())
    yield f"  stages [ms, with compiling]: {stages}"
    for solved in dump.problems:
        problem, report = solved.problem, solved.result.report
        knots, leads = problem.lower.shape[1], len(problem.leads)
        bounds = int((abs(problem.lower) < 1e9).sum() + (abs(problem.upper) < 1e9).sum())
        outcome = "solved" if report.solved else "NOT SOLVED"
        yield (
            f"  {report.stage}: {3 * knots} unknowns, {2 * (knots - 1) + 3} equalities, "
            f"{counted(bounds, 'finite bound')}, {counted(leads, 'lead')}; {outcome} "
            f"({report.status}), {counted(report.iterations, 'iteration')}, residuals "
            f"{report.primal_residual:.1e}, {report.dual_residual:.1e}"
        )
    for report in (
        artefact
        for artefact in plan.internals
        if isinstance(artefact, SolverReport) and not dump.problems
    ):
        yield f"  {report.stage}: {report.status}, {counted(report.iterations, 'iteration')}"
    yield ""
    planned = PlannedFrame.of(frame, plan)
    shown = PlannerInput(planned, frame.agents, planned.predictions, frame.lights)
    lines = lines_of(Explanation.of(planned, Explainer(again.scenario).account(shown)))
    yield from map(again.scenario.short_names, lines)
