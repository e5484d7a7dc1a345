"""A planner that a network drives: trained by `train.py` on arrays of `replan export features`.

    replan evaluate LOGS --planner learned_planner:Learned --set loop.apart.batch=8

The network answers speeds over time and offsets from the route over the way (`route_view`). The
plan goes through them from the state of the ego on, as the path

(1) p(s) = r(s) + l(s) n(s),   l the cubic spline through the offsets, with the ego's l and l' at 0

driven with the speed v(t) that is linear between its knots. So it begins at the ego, and positions,
heading, curvature, speed and acceleration agree.
"""

import numpy as np
from route_view import COLUMN, KNOTS_M, KNOTS_S, NEEDED, SIZES, inputs, start_on_route
from scipy.interpolate import CubicSpline

from replan import Plan, PlanStatus, Trajectory
from replan.features import features_of

STEP_S, SPACING_M = 0.1, 2.0
MOST_MPS2 = 2.5  # of acceleration; braking is bounded by BRAKE_MPS2
BRAKE_MPS2 = 8.0
STEEPEST = 1.0  # l' at the start
LATERAL_MPS2 = 4.0
LEAST_MPS = 0.2  # slower than this at all knots, the ego stands


class Learned:
    """Drives as the network says, along its route."""

    past_s = 2.1
    net = None

    @classmethod
    def prepare(cls, *, weights: str = "weights.npz"):
        """Load the network, once for all drives."""
        try:
            import torch
        except ImportError:
            raise ImportError("this planner needs torch: pip install 'replan[learned]'") from None
        from network import Net

        torch.set_num_threads(1)
        cls.net = Net()
        with np.load(weights) as file:
            cls.net.load_state_dict({name: torch.from_numpy(file[name]) for name in file.files})
        cls.net.eval()

    def __init__(self, context, *, weights: str = "weights.npz"):
        self.context = context

    def plan(self, frame):
        """One frame is a batch of one."""
        return self.plan_batch([frame], [self])[0]

    @classmethod
    def plan_batch(cls, frames, planners):
        """The plans of the frames of all logs, by one pass of the network."""
        import torch

        seen = [
            features_of(frame, planner.context, SIZES).arrays()
            for frame, planner in zip(frames, planners, strict=True)
        ]
        batch = {name: np.stack([arrays[name] for arrays in seen]) for name in NEEDED}
        with torch.inference_mode():
            tensors = [torch.from_numpy(array) for array in inputs(batch).values()]
            speeds, offsets = (answer.double().numpy() for answer in cls.net(*tensors))
        routes = [row[mask] for row, mask in zip(batch["route"], batch["route_mask"], strict=True)]
        return [plan_of(*row) for row in zip(frames, routes, speeds, offsets, strict=True)]


def plan_of(frame, route, speeds, offsets):
    """The plan through speeds and offsets along a route `(n, columns)`; a stop without a route."""
    ego, t = frame.ego, np.arange(0.0, KNOTS_S[-1] + 1e-9, STEP_S)
    if len(route) < 2:
        speeds = np.maximum(ego.v - 3.0 * KNOTS_S, 0.0)
    if speeds.max() < LEAST_MPS:
        speeds = np.zeros_like(speeds)
    v = speed_profile(max(ego.v, 0.0), speeds, t)
    way = np.r_[0.0, np.cumsum(0.5 * STEP_S * (v[1:] + v[:-1]))]
    a = np.gradient(v, STEP_S)
    x, y, yaw, kappa = drivable_path(ego, route, offsets, way, v)
    trajectory = Trajectory(frame.t + t, x, y, yaw, v, a, kappa)
    if len(route) < 2:
        return Plan(trajectory, status=PlanStatus.COMFORTABLE_STOP, reason="no route lies ahead")
    return Plan(trajectory)


def speed_profile(v0, speeds, t):
    """Speeds at the times `t` through those of the knots, with possible accelerations."""
    knots, step = [v0], KNOTS_S[0]
    for speed in speeds:
        least, most = knots[-1] - BRAKE_MPS2 * step, knots[-1] + MOST_MPS2 * step
        knots.append(float(np.clip(speed, least, most)))
    return np.maximum(np.interp(t, np.r_[0.0, KNOTS_S], knots), 0.0)


def drivable_path(ego, route, offsets, way, v):
    """World x, y, yaw and curvature after each length of way `(n,)`, driven with speeds `v`.

    Where the path through all offsets asks for more than `LATERAL_MPS2`, the near ones are left
    out, and at last all: then it keeps its offset.
    """
    for first in range(len(KNOTS_M) + 1):
        path = path_of(ego, route, KNOTS_M[first:], offsets[first:], way)
        if np.abs(path[3] * v**2).max() <= LATERAL_MPS2:
            break
    return path


def path_of(ego, route, knots, offsets, way):
    """The path (1) through offsets at these knots: x, y, yaw, curvature."""
    points = _offset_route(ego, route, knots, offsets, way[-1])
    chord = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    spline = CubicSpline(chord, points, bc_type=((1, (1.0, 0.0)), (2, (0.0, 0.0))))
    (x, y), (dx, dy), (ddx, ddy) = (spline(way, order).T for order in (0, 1, 2))
    c, s = np.cos(ego.yaw), np.sin(ego.yaw)
    kappa = (dx * ddy - dy * ddx) / np.maximum(dx**2 + dy**2, 1e-6) ** 1.5
    yaw = ego.yaw + np.unwrap(np.arctan2(dy, dx))
    return ego.x + c * x - s * y, ego.y + s * x + c * y, yaw, kappa


def _offset_route(ego, route, knots, offsets, length):
    """Points of the path in the ego's frame, from its rear axle on, at least as long as needed."""
    if len(route) < 2:
        return np.array([[0.0, 0.0], [length + 1.0, 0.0]])
    route = route.astype(np.float64)
    stations = SIZES.route_step_m * np.arange(len(route))
    line = CubicSpline(stations, route[:, :2])
    offset, turn = (float(value[0]) for value in start_on_route(route[None]))
    slope = float(np.clip(np.tan(np.clip(turn, -1.2, 1.2)), -STEEPEST, STEEPEST))
    slope *= 1.0 - offset * route[0, COLUMN["kappa"]]
    if not len(knots):
        knots, offsets = KNOTS_M[-1:], [offset]
    ends = ((1, slope), (1, 0.0))
    lateral = CubicSpline(np.r_[0.0, knots], np.r_[offset, offsets], bc_type=ends)
    s = np.arange(0.0, max(length, KNOTS_M[-1]) + 10.0, SPACING_M)
    along = line(np.minimum(s, stations[-1]), 1)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    beyond = np.maximum(s - stations[-1], 0.0)[:, None] * along
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    l = lateral(np.minimum(s, KNOTS_M[-1]))
    points = line(np.minimum(s, stations[-1])) + beyond + l[:, None] * normal
    return points - points[0]  # it begins at the rear axle
