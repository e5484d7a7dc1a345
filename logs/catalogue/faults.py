"""Logs with faults: of perception (the tracks of road users), of the ego's start, and of the lanes.

No public suite has them; the values are replan's own. Faults of perception are in the tracks of a
catalogue scene: 0 the crossing pedestrian, 1 a lead, 2 a cut-in. In the closed loop the log is the
world: the planner perceives a track with its gap, and the evaluation interpolates it
(`replan.logs.observed`); a delayed track is another world there, and is wrong relative to the ego
in the open loop only. Faults of ego and lanes are in the free road; the log then has the first ego
state only, since no drive on that road exists.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import cos, radians, sin, tan

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, arc_lengths
from replan.logs.catalogue import everyday, paper
from replan.logs.catalogue.family import Family, family
from replan.logs.catalogue.family_parts import BEYOND_M, SAMPLE_S
from replan.logs.catalogue.roads import LANE_WIDTH_M
from replan.logs.road import Goal
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks

SCENES = (paper.crossing_pedestrian, everyday.follow, everyday.cut_in)
SOURCE = "ours"
GOAL_SECTIONS = 6
"""Number of last cross-sections (10 m) in the goal if the fault changes where the lane ends."""
SEEDS = (1.0, 2.0, 3.0)
Lines = tuple[FloatArray, FloatArray]


def _perception(
    name: str, summary: str, defaults: Mapping[str, float], grid: Mapping[str, tuple[float, ...]]
) -> Callable[[Callable[[Tracks, Mapping[str, float]], Tracks]], Family]:
    def made(fault: Callable[[Tracks, Mapping[str, float]], Tracks]) -> Family:
        def build(p: Mapping[str, float]) -> Scenario:
            if p["scene"] not in range(len(SCENES)):
                raise ValueError(
                    f"scene is {p['scene']:g}: 0 is the crossing pedestrian, 1 the lead, 2 the "
                    "cut-in"
                )
            scene = SCENES[int(p["scene"])]
            whole = scene.build(scene.parameters)
            return replace(whole, tracks=fault(whole.tracks, p))

        scenes = {"scene": tuple(float(k) for k in range(len(SCENES)))}
        tags, parameters = ("faults", "perception"), {"scene": 0.0, **defaults}
        return Family(
            f"faults/{name}", summary, parameters, tags, build, {**scenes, **grid}, SOURCE
        )

    return made


def _keep_samples(tracks: Tracks, keep: BoolArray) -> Tracks:
    """The tracks with some of their samples; ValueError if a track has none left."""
    left = tracks.taken(keep)
    if len(left) < len(tracks):
        raise ValueError("nothing is left of a track")
    return left


@_perception(
    "flicker",
    "boxes come and go frame by frame",
    {"shown_frames": 1.0, "hidden_frames": 1.0},
    {"shown_frames": (1.0, 2.0, 5.0), "hidden_frames": (1.0, 2.0, 4.0)},
)
def flicker(tracks: Tracks, p: Mapping[str, float]) -> Tracks:
    shown, hidden = int(p["shown_frames"]), int(p["hidden_frames"])
    return _keep_samples(
        tracks, np.rint(tracks.t / SAMPLE_S).astype(np.int64) % (shown + hidden) < shown
    )


@_perception(
    "dropout",
    "all boxes are gone for a while",
    {"from_s": 6.0, "lasts_s": 0.5},
    {"from_s": (4.0, 6.0, 8.0), "lasts_s": (0.3, 0.5, 1.0, 2.0)},
)
def dropout(tracks: Tracks, p: Mapping[str, float]) -> Tracks:
    return _keep_samples(
        tracks, (tracks.t < p["from_s"] - 1e-9) | (tracks.t >= p["from_s"] + p["lasts_s"] - 1e-9)
    )


@_perception("late", "a box appears late", {"first_s": 5.0}, {"first_s": (1.0, 3.0, 5.0, 6.0)})
def late(tracks: Tracks, p: Mapping[str, float]) -> Tracks:
    return _keep_samples(tracks, tracks.t >= p["first_s"] - 1e-9)


@_perception(
    "latency",
    "boxes are where they were a while ago",
    {"latency_s": 0.3},
    {"latency_s": (0.1, 0.2, 0.3, 0.5)},
)
def delayed(tracks: Tracks, p: Mapping[str, float]) -> Tracks:
    return replace(tracks, t=np.round(tracks.t + p["latency_s"], 9))


@_perception(
    "noise",
    "positions and headings are noisy",
    {"position_m": 0.1, "yaw_deg": 5.0, "seed": 1.0},
    {"position_m": (0.02, 0.1, 0.3), "yaw_deg": (0.0, 5.0), "seed": SEEDS},
)
def noisy(tracks: Tracks, p: Mapping[str, float]) -> Tracks:
    rng = np.random.default_rng(int(p["seed"]))
    x, y, yaw = (rng.standard_normal(len(tracks.t)) for _ in range(3))
    return replace(
        tracks,
        x=tracks.x + p["position_m"] * x,
        y=tracks.y + p["position_m"] * y,
        yaw=tracks.yaw + radians(p["yaw_deg"]) * yaw,
    )


@_perception(
    "sparse",
    "few frames, and no velocities",
    {"every_frames": 2.0},
    {"every_frames": (1.0, 2.0, 5.0, 10.0)},
)
def sparse(tracks: Tracks, p: Mapping[str, float]) -> Tracks:
    """One frame of every `every`, without velocities."""
    left = _keep_samples(
        tracks, np.rint(tracks.t / SAMPLE_S).astype(np.int64) % int(p["every_frames"]) == 0
    )
    return replace(left, vx=np.full(len(left.t), np.nan), vy=np.full(len(left.t), np.nan))


@family(
    "faults/start",
    "the ego starts beside its line, at an angle to it, slower than the limit",
    ("faults", "ego"),
    {"lateral_m": 0.5, "heading_deg": 0.0, "speed_factor": 1.0},
    {
        "lateral_m": (-0.6, -0.3, 0.0, 0.3, 0.6),
        "heading_deg": (-5.0, 0.0, 5.0),
        "speed_factor": (0.0, 0.5, 1.0),
    },
    SOURCE,
)
def started(p: Mapping[str, float]) -> Scenario:
    """The ego beside its lane's middle, at an angle to it, and at another speed than the lane's."""
    whole = paper.free_road.build(paper.free_road.parameters)
    first, turned = whole.ego.between(0.0, 0.0), radians(p["heading_deg"])
    ego = replace(
        first,
        x=first.x - p["lateral_m"] * np.sin(first.yaw),
        y=first.y + p["lateral_m"] * np.cos(first.yaw),
        yaw=first.yaw + turned,
        v=first.v * p["speed_factor"],
    )
    return replace(whole, ego=ego)


def _lanes(
    name: str, summary: str, defaults: Mapping[str, float], grid: Mapping[str, tuple[float, ...]]
) -> Callable[[Callable[[Lines, Mapping[str, float]], Lines]], Family]:
    def made(fault: Callable[[Lines, Mapping[str, float]], Lines]) -> Family:
        def build(p: Mapping[str, float]) -> Scenario:
            whole = paper.free_road.build(paper.free_road.parameters)
            lane = whole.road.lanes[1]
            left, right = fault((lane.left, lane.right), p)
            road = replace(whole.road, lanes={1: replace(lane, left=left, right=right)})
            reaches = bool(np.hypot(*(left[-1] - lane.left[-1])) < LANE_WIDTH_M)
            last = Goal((np.vstack([left[-GOAL_SECTIONS:], right[: -GOAL_SECTIONS - 1 : -1]]),))
            return replace(
                whole,
                ego=whole.ego.between(0.0, 0.0),
                road=road,
                goal=whole.goal if reaches else last,
            )

        return Family(f"faults/{name}", summary, defaults, ("faults", "lanes"), build, grid, SOURCE)

    return made


@_lanes(
    "lane_noise",
    "lane boundaries are noisy",
    {"position_m": 0.05, "seed": 1.0},
    {"position_m": (0.02, 0.05, 0.1, 0.2), "seed": SEEDS},
)
def noisy_lines(lines: Lines, p: Mapping[str, float]) -> Lines:
    rng = np.random.default_rng(int(p["seed"]))
    left, right = (line + p["position_m"] * rng.standard_normal(line.shape) for line in lines)
    return left, right


@_lanes(
    "lane_coarse",
    "lane boundaries have few points",
    {"spacing_m": 10.0},
    {"spacing_m": (4.0, 6.0, 10.0, 20.0)},
)
def coarse_lines(lines: Lines, p: Mapping[str, float]) -> Lines:
    """Keep one cross-section per step in metres (they are 2 m apart), and the last."""
    keep = np.unique(np.r_[0 : len(lines[0]) : round(p["spacing_m"] / 2.0), len(lines[0]) - 1])
    return lines[0][keep], lines[1][keep]


@_lanes(
    "lane_doubled",
    "points of the lane boundaries are there twice",
    {"every": 5.0},
    {"every": (1.0, 2.0, 5.0)},
)
def doubled_lines(lines: Lines, p: Mapping[str, float]) -> Lines:
    """Repeat each n-th cross-section."""
    count = 1 + (np.arange(len(lines[0])) % int(p["every"]) == 0)
    return np.repeat(lines[0], count, axis=0), np.repeat(lines[1], count, axis=0)


@_lanes(
    "lane_kink",
    "the lane has a kink",
    {"angle_deg": 30.0, "straight_m": 80.0},
    {"angle_deg": (-45.0, -30.0, -15.0, 15.0, 30.0, 45.0)},
)
def kinked_lines(lines: Lines, p: Mapping[str, float]) -> Lines:
    """Two straight pieces as long as the lane together, with an angle between them after
    `straight_m`.
    """
    angle, half = radians(p["angle_deg"]), 0.5 * LANE_WIDTH_M
    rest = (
        float(np.hypot(*np.diff(lines[0] + lines[1], axis=0).T).sum()) / 2.0
        - p["straight_m"]
        - BEYOND_M
    )
    s, mitre = np.arange(0.0, p["straight_m"], 2.0), half * tan(0.5 * angle)
    middle = np.array([p["straight_m"], 0.0])
    beyond = np.arange(2.0 + abs(mitre), rest, 2.0)[:, None]
    along, left = np.array([cos(angle), sin(angle)]), np.array([-sin(angle), cos(angle)])
    edges = [
        np.vstack(
            [
                np.column_stack(
                    [
                        s[s < middle[0] - abs(mitre)],
                        np.full((s < middle[0] - abs(mitre)).sum(), side * half),
                    ]
                ),
                middle + np.array([-side * mitre, side * half]),
                middle + beyond * along + side * half * left,
            ]
        )
        for side in (1.0, -1.0)
    ]
    return edges[0], edges[1]


@_lanes(
    "lane_ends",
    "the lane ends before the log does",
    {"length_m": 60.0},
    {"length_m": (30.0, 60.0, 100.0)},
)
def ended_lines(lines: Lines, p: Mapping[str, float]) -> Lines:
    """The lane ends after a length in metres."""
    keep = arc_lengths(*(0.5 * (lines[0] + lines[1])).T) <= p["length_m"]
    return lines[0][keep], lines[1][keep]


@_lanes(
    "lane_narrow",
    "the lane becomes narrow",
    {"width_m": 2.5, "from_m": 60.0},
    {"width_m": (1.5, 2.0, 2.5, 3.0)},
)
def narrow_lines(lines: Lines, p: Mapping[str, float]) -> Lines:
    """The lane is narrower from a station (m) on."""
    middle, half = 0.5 * (lines[0] + lines[1]), 0.5 * (lines[0] - lines[1])
    s = arc_lengths(*middle.T)
    narrower = p["width_m"] / LANE_WIDTH_M
    share = np.asarray(np.interp(s, [p["from_m"], p["from_m"] + 10.0], [1.0, narrower]))[:, None]
    return middle + share * half, middle - share * half


FAMILIES = (
    flicker,
    dropout,
    late,
    delayed,
    noisy,
    sparse,
    started,
    noisy_lines,
    coarse_lines,
    doubled_lines,
    kinked_lines,
    ended_lines,
    narrow_lines,
)
