"""A hand-made drive with full internals, so that recordings can be tested without a planner.

An S-curve of three lanes (two in the ego's direction, one oncoming). The ego follows a lead car,
passes a parked car on the left and brakes for a pedestrian who is in its path from 9 s to 11.5 s.
The numbers are made up but agree with each other: what the graphs show is what the ego then does.
"""

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.plan import (
    Corridor,
    CostTerms,
    Decision,
    DecisionKind,
    GraphObstacle,
    GridCost,
    Plan,
    PlanStart,
    PlanStatus,
    SlGraph,
    SolverReport,
    StGraph,
)
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Goal, Lane, Road
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace, TrackingErrors
from replan.logs.tracks import Tracks
from replan.replay.drive import Drive, StageTime

END_S = 20.0
HORIZON_S = 8.0
PARKED_S, PEDESTRIAN_S = 60.0, 119.0
BLOCKED = (9.0, 11.5)
FINE = np.arange(0.0, END_S + HORIZON_S + 0.005, 0.01)
SPEED = np.interp(FINE, [0.0, 6.0, 10.0, 11.8, 17.0, 40.0], [12.0, 12.0, 2.5, 2.5, 12.0, 12.0])
STATION = np.r_[0.0, np.cumsum(0.5 * np.diff(FINE) * (SPEED[1:] + SPEED[:-1]))] + 5.0


def centre_line() -> ReferenceLine:
    x = np.linspace(0.0, 340.0, 171)
    return ReferenceLine.through(np.column_stack([x, 14.0 * np.sin(x / 45.0)]))


LINE = centre_line()


def to_world(s: FloatArray, l: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    s = np.asarray(s, dtype=float)
    x, y = np.interp(s, LINE.s, LINE.xy[:, 0]), np.interp(s, LINE.s, LINE.xy[:, 1])
    yaw = np.interp(s, LINE.s, LINE.yaw)
    return x - l * np.sin(yaw), y + l * np.cos(yaw), yaw


def offset(s: FloatArray) -> FloatArray:
    """Lateral offset of the ego's path: it swings left around the parked car."""
    return 1.3 * np.exp(-(((np.asarray(s) - PARKED_S) / 14.0) ** 2))


def road() -> Road:
    def strip(right: float, left: float) -> dict[str, FloatArray]:
        edge = [
            np.column_stack(to_world(LINE.s[::3], np.full(len(LINE.s[::3]), at))[:2])
            for at in (left, right)
        ]
        return {"left": edge[0], "right": edge[1]}

    oncoming = strip(5.25, 8.75)
    lanes = [
        Lane(1, **strip(-1.75, 1.75), left_neighbour=2, speed_limit=13.89, right_crossable=False),
        Lane(
            2,
            **strip(1.75, 5.25),
            right_neighbour=1,
            left_opposite=True,
            left_crossable=False,
            speed_limit=13.89,
        ),
        Lane(
            3,
            left=oncoming["right"][::-1],
            right=oncoming["left"][::-1],
            left_opposite=True,
            left_crossable=False,
        ),
    ]
    return Road({lane.id: lane for lane in lanes})


def trajectory(t: FloatArray, t_world: FloatArray) -> Trajectory:
    """The ego's motion at the world times `t_world`, stamped `t`."""
    s = np.interp(t_world, FINE, STATION)
    v = np.interp(t_world, FINE, SPEED)
    x, y, yaw = to_world(s, offset(s))
    a = np.interp(t_world, FINE, np.gradient(SPEED, FINE))
    return Trajectory(t, x, y, yaw, v, a, np.interp(s, LINE.s, LINE.kappa))


def tracks(extra: int = 0, pedestrian: str = "ped 7") -> Tracks:
    """The lead car, the parked car, the pedestrian, an oncoming truck, and `extra` cars further
    on.
    """
    t = np.arange(0.0, END_S + 0.01, 0.1)
    lead = np.interp(t, FINE, STATION) + 22.0 + 0.8 * t
    walk = np.interp(t, [0.0, BLOCKED[0] - 3.5, BLOCKED[1], END_S], [-7.0, -7.0, 3.0, 6.5])
    motions = [
        ("car 12", AgentKind.CAR, 4.6, 1.9, False, to_world(lead, np.zeros_like(t))),
        (
            "parked 3",
            AgentKind.CAR,
            4.4,
            1.8,
            True,
            to_world(np.full(1, PARKED_S), np.full(1, -1.6)),
        ),
        (
            pedestrian,
            AgentKind.PEDESTRIAN,
            0.6,
            0.6,
            False,
            to_world(np.full(len(t), PEDESTRIAN_S), walk),
        ),
        (
            "truck 40",
            AgentKind.TRUCK,
            9.5,
            2.5,
            False,
            to_world(230.0 - 9.0 * t, np.full(len(t), 7.0)),
        ),
    ]
    for i in range(extra):
        s = np.clip(30.0 + 5.5 * i + (3.0 + 0.2 * i) * t, 0.0, LINE.length)
        motions.append(
            (
                f"extra {i}",
                AgentKind.CAR,
                4.5,
                1.8,
                False,
                to_world(s, np.full(len(t), 3.5 * (i % 2))),
            )
        )
    counts = [len(motion[5][0]) for motion in motions]
    pose = [np.concatenate([motion[5][k] for motion in motions]) for k in range(3)]
    missing = np.full(sum(counts), np.nan)
    ids, kinds, length, width, static, _ = zip(*motions, strict=True)
    times = np.concatenate([t[:count] for count in counts])
    offsets = np.r_[0, np.cumsum(counts)]
    sizes = np.array(length), np.array(width), np.array(static)
    return Tracks(ids, kinds, *sizes, offsets, times, *pose, missing, missing)


def scenario(
    extra: int = 0, *, name: str = "sample/s_curve", pedestrian: str = "ped 7"
) -> Scenario:
    t = np.arange(0.0, END_S + 0.01, 0.1)
    corners = np.array([[200.0, 2.0], [200.0, -2.0], [212.0, -2.0], [212.0, 2.0]])
    finish = np.column_stack(to_world(corners[:, 0], corners[:, 1])[:2])
    ego, notes = (
        trajectory(t, np.minimum(1.06 * t, END_S)),
        ("The goal is a strip across the ego's lane.",),
    )
    about = {"tags": ("sample", "pedestrian"), "source": "made by hand", "notes": notes}
    return Scenario(
        name, ego, tracks(extra, pedestrian), road(), END_S, goal=Goal((finish,)), **about
    )


def sl_graph(s0: float) -> SlGraph:
    first, second = s0 + np.arange(0.0, 71.0, 10.0), np.arange(-3.0, 3.01, 0.5)
    gap = np.hypot((first[:, None] - PARKED_S) / 4.0, second[None, :] + 1.6)
    cost = np.abs(second)[None, :] * 2.0 + 40.0 / (0.2 + gap) + 0.3 * np.arange(len(first))[:, None]
    cost[:, second < -2.6] = np.inf
    chosen = np.argmin(np.abs(second[None, :] - offset(first)[:, None]), axis=1)
    path = np.linspace(s0, s0 + 70.0, 71)
    beside = np.abs(path - PARKED_S) < 4.5
    corridor = Corridor(
        path, np.where(beside, -0.5, -0.9), np.where(np.abs(path - 30.0) < 6.0, np.inf, 4.4)
    )
    outline = np.array(
        [[PARKED_S + x, y] for x, y in ((-2.2, -2.5), (2.2, -2.5), (2.2, -0.7), (-2.2, -0.7))]
    )
    near = s0 - 5.0 < PARKED_S < s0 + 70.0
    parked = (GraphObstacle("parked 3", outline, DecisionKind.NUDGE_LEFT),) if near else ()
    dp = np.column_stack([first, second[chosen]])
    return SlGraph(
        GridCost(first, second, cost, chosen),
        corridor,
        dp,
        np.column_stack([path, offset(path)]),
        parked,
    )


def st_graph(t0: float, s0: float, reach: float = 110.0, pedestrian: str = "ped 7") -> StGraph:
    first, second = np.arange(0.0, HORIZON_S + 0.1, 1.0), np.arange(0.0, reach + 0.1, 0.5)
    t = np.linspace(0.0, HORIZON_S, 81)
    s = np.interp(t0 + t, FINE, STATION) - s0
    chosen = np.searchsorted(second, np.interp(first, t, s)).clip(0, len(second) - 1)
    cost = (second[None, :] - np.interp(first, t, s)[:, None]) ** 2 * 0.1 + 5.0 * first[:, None]
    cost[second[None, :] > 14.5 * first[:, None] + 0.1] = np.inf
    bumper = np.interp(t0 + t, FINE, STATION) + 22.0 + 0.8 * (t0 + t) - s0 - 5.9
    follow = np.vstack([np.column_stack([t, bumper]), np.column_stack([t, bumper + 5.0])[::-1]])
    obstacles = [GraphObstacle("car 12", follow, DecisionKind.FOLLOW)]
    upper = bumper - 2.0
    enter, leave, ahead = max(BLOCKED[0] - t0, 0.0), BLOCKED[1] - t0, PEDESTRIAN_S - s0
    if enter < HORIZON_S and leave > 0.0 and ahead > 0.0:
        box = np.array(
            [[enter, ahead - 5.0], [leave, ahead - 3.0], [leave, ahead + 3.0], [enter, ahead + 1.0]]
        )
        obstacles.append(GraphObstacle(pedestrian, box, DecisionKind.YIELD))
        upper = np.where((t >= enter) & (t <= leave), np.minimum(upper, ahead - 5.0), upper)
    corridor = Corridor(t, np.full(len(t), -np.inf), np.where(t > 7.0, np.inf, upper))
    dp = np.column_stack([first, second[chosen]])
    return StGraph(
        GridCost(first, second, cost, chosen),
        corridor,
        dp,
        np.column_stack([t, s]),
        tuple(obstacles),
    )


def plan(t0: float, *, pedestrian: str = "ped 7") -> Plan:
    t = np.linspace(0.0, HORIZON_S, 81)
    s0 = float(np.interp(t0, FINE, STATION))
    st = st_graph(t0, s0, pedestrian=pedestrian)
    yields = any(obstacle.decision is DecisionKind.YIELD for obstacle in st.obstacles)
    decisions = [
        Decision(
            "car 12",
            DecisionKind.FOLLOW,
            "speed",
            "ahead in the lane, 22.0 m, not slower than the ego",
        ),
        Decision("truck 40", DecisionKind.IGNORE, "path", "outside the corridor"),
    ]
    if abs(s0 - PARKED_S + 25.0) < 35.0:
        decisions.append(
            Decision(
                "parked 3", DecisionKind.NUDGE_LEFT, "path", "1.3 m of room on the left, none right"
            )
        )
    if yields:
        why = f"in the path until {BLOCKED[1]} s; passing first is late"
        decisions.append(Decision(pedestrian, DecisionKind.YIELD, "speed", why))
    failed = 14.0 <= t0 < 14.25
    status, reason = (
        (PlanStatus.PREVIOUS, "primal infeasible") if failed else (PlanStatus.PLANNED, "")
    )
    internals = (
        sl_graph(s0),
        st,
        *decisions,
        CostTerms(
            "path",
            (("reference", 1.25), ("obstacle", 3.5 if yields else 0.4), ("smoothness", 0.02)),
        ),
        CostTerms("speed", (("speed", 8.1), ("jerk", 0.7))),
        SolverReport("path QP", True, "solved", 50, 2.1e-6, 4.0e-6),
        SolverReport("speed QP", not failed, reason or "solved", 75, 1e-5, 3e-4),
    )
    start = PlanStart.PREVIOUS_PLAN if t0 > 0 else PlanStart.EGO
    return Plan(
        trajectory(t0 + t, t0 + t), status, reason and f"speed QP: {reason}", start, internals
    )


def drive(
    mode: Mode = Mode.CLOSED, *, extra: int = 0, pedestrian: str = "ped 7"
) -> tuple[Drive, Scenario]:
    """20 s: the ego at 100 Hz (closed) or 10 Hz (open), frames at 10 Hz, timings of four stages."""
    world = scenario(extra, pedestrian=pedestrian)
    grid = np.round(np.arange(0.0, END_S - 0.01, 0.1), 3)
    t = np.round(np.arange(0.0, END_S + 0.001, 0.01), 3) if mode is Mode.CLOSED else grid
    ego = trajectory(t, t)
    pedals = Controls(
        t, 0.03 * np.sin(0.5 * t), np.clip(ego.a / 4.5, 0.0, 1.0), np.clip(-ego.a / 9.0, 0.0, 1.0)
    )
    errors = TrackingErrors(
        t, 0.06 * np.sin(t), 0.01 * np.cos(t), 0.2 * np.sin(0.7 * t), 0.4 * np.sin(0.3 * t)
    )
    frames = tuple(PlannedFrame(float(at), plan(float(at), pedestrian=pedestrian)) for at in grid)
    driven = (
        {"commands": pedals, "actuation": pedals, "tracking": errors} if mode is Mode.CLOSED else {}
    )
    trace = Trace(
        world.name,
        "dp_qp",
        mode,
        False,
        ego,
        world.tracks,
        frames,
        EndReason.GOAL,
        "goal region 1",
        notes=("Agents are replayed by time.",),
        **driven,
    )
    stages = {"path_dp": 2e-4, "path_qp": 4e-4, "speed_dp": 3e-4, "speed_qp": 5e-4, "total": 1.5e-3}
    timings = [
        StageTime(float(at), stage, mean * (1.0 + 0.3 * np.sin(7.0 * at + len(stage))))
        for at in grid
        for stage, mean in stages.items()
    ]
    return Drive(trace, tuple(timings)), world
