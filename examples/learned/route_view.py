"""Features seen along the route: what the network of this example gets, and what it answers.

All in the frame of the route's line: station s from beside the ego, offset l to the left, m. So a
curve looks like a straight road, and few logs suffice. NumPy, for batches `(B, ...)` of the arrays
of `replan.features.Features`: training and driving use the same functions.

The answer is `KNOTS_S` speeds, m/s, and `KNOTS_M` offsets, m, that the plan goes through.
"""

import numpy as np

from replan.features import ROUTE_COLUMNS, FeatureSizes

SIZES = FeatureSizes()
NEEDED = (
    "ego",
    "ego_size",
    "agents",
    "agents_size",
    "agents_kind",
    "agents_mask",
    "objects",
    "objects_mask",
    "route",
    "route_mask",
)
"""The features that the network reads."""
KNOTS_S = np.arange(0.5, 4.01, 0.5)
KNOTS_M = np.arange(8.0, 40.1, 8.0)
PAST = (16, 11)  # steps of a history: 0.5 and 1 s ago
NOW = 21
MARKS = ("red", "yellow", "must_stop", "crosswalk", "yields")
COLUMN = {name: column for column, name in enumerate(ROUTE_COLUMNS)}
STATIONS = (0, 5, 10, 15, 20, 30, 40, 60)  # points of the route whose curvature and limit are seen
FAR_M = 160.0  # length of the route that is seen
REACHED_M, BEYOND = 1.5, 0.2  # what reaches a knot, and the weight of a knot that is not reached
EGO_INPUTS, AGENT_INPUTS = 36, 27


def cross(a, b):
    """Third component of the cross product of vectors `(..., 2)`."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def along_route(route, mask, points):
    """Station and offset of points `(B, n, 2)`, and the route's direction there `(B, n, 2)`."""
    away = np.linalg.norm(points[:, :, None] - route[:, None, :, :2], axis=-1)
    nearest = np.where(mask[:, None], away, np.inf).argmin(axis=2)
    rows = np.arange(len(route))[:, None]
    foot, along = route[rows, nearest, :2], route[rows, nearest, 2:4]
    step = points - foot
    return nearest * SIZES.route_step_m + (step * along).sum(axis=-1), cross(along, step), along


def usable(arrays):
    """The samples `(B,)` that have a route, with the ego on it."""
    return arrays["route_mask"].sum(axis=1) >= 2


def inputs(arrays):
    """Inputs of the network: `ego` `(B, EGO_INPUTS)`, `agents` `(B, n, AGENT_INPUTS)`, `mask`."""
    route, on_route = arrays["route"].astype(np.float64), arrays["route_mask"]
    agents, mask = _agents(arrays, route, on_route)
    return {
        "ego": _ego(arrays, route, on_route).astype(np.float32),
        "agents": agents.astype(np.float32),
        "mask": mask,
    }


def _ego(arrays, route, on_route):
    ego = arrays["ego"].astype(np.float64)
    now, begin = ego[:, NOW], route[:, 0]
    offset, turn = start_on_route(route)
    past = [ego[:, k, 4] - now[:, 4] for k in PAST]
    seen = [np.minimum(k, on_route.sum(axis=1) - 1) for k in STATIONS]
    rows = np.arange(len(route))
    kappa = [50.0 * route[rows, k, COLUMN["kappa"]] for k in seen]
    limit = [route[rows, k, COLUMN["limit"]] / 10.0 for k in seen]
    sides = [begin[:, COLUMN[name]] for name in ("left", "right")]
    marks = [nearest_mark(route, on_route, name) for name in MARKS]
    ahead = [on_route.sum(axis=1) * SIZES.route_step_m / FAR_M]
    motion = [now[:, 4] / 10.0, now[:, 6], 50.0 * np.tan(now[:, 8]) / 2.8, offset, 10.0 * turn]
    return np.column_stack([*motion, *past, *kappa, *limit, *sides, *marks, *ahead])


def start_on_route(route):
    """Offset of the ego from the route, m, and its heading off the route's, rad, `(B,)`."""
    begin = route[:, 0]
    turn = -np.arctan2(begin[:, COLUMN["sin_yaw"]], begin[:, COLUMN["cos_yaw"]])
    return cross(begin[:, 2:4], -begin[:, :2]), turn


def nearest_mark(route, on_route, name):
    """How near the first point with this mark is: two numbers from 0 (none) to 1 `(B, 2)`."""
    mark = route[..., COLUMN[name]] * on_route
    first = (mark > 1e-3).argmax(axis=1)
    weight = mark[np.arange(len(mark)), first]
    s = SIZES.route_step_m * (first + 1.0 - weight)  # of a stop line, the next point has the rest
    s = np.where(weight > 0.0, s, np.inf)
    return np.column_stack([1.0 / (1.0 + s / 20.0), np.exp(-s / 60.0)])


def _agents(arrays, route, on_route):
    """Agents, then objects, as tokens."""
    agents, size = arrays["agents"].astype(np.float64), arrays["agents_size"]
    objects = arrays["objects"].astype(np.float64)
    standing = np.concatenate([objects[..., :4], np.zeros_like(objects[..., :2])], axis=-1)
    now = np.concatenate([agents[:, :, NOW], standing], axis=1)
    size = np.concatenate([size, objects[..., 4:6]], axis=1)
    kind = np.concatenate([arrays["agents_kind"], np.full(objects.shape[:2], 6)], axis=1)
    mask = np.concatenate([arrays["agents_mask"], arrays["objects_mask"]], axis=1)
    s, l, along = along_route(route, on_route, now[..., :2])
    vs, vl = (now[..., 4:6] * along).sum(axis=-1), cross(along, now[..., 4:6])
    c, sin = (now[..., 2:4] * along).sum(axis=-1), cross(along, now[..., 2:4])
    half_s = 0.5 * (np.abs(c) * size[..., 0] + np.abs(sin) * size[..., 1])
    half_l = 0.5 * (np.abs(sin) * size[..., 0] + np.abs(c) * size[..., 1])
    changes = []
    for k in PAST:
        before = np.concatenate([agents[:, :, k, 4:6], standing[..., 4:6]], axis=1)
        changes += [vs - (before * along).sum(axis=-1), vl - cross(along, before)]
    car = arrays["ego_size"].astype(np.float64)[:, None]
    speed = arrays["ego"][:, None, NOW, 4]
    front = 0.5 * car[..., 0] + car[..., 3]
    offset = start_on_route(route)[0][:, None]
    gap = s - half_s - front
    room = np.abs(l - offset) - half_l - 0.5 * car[..., 1]
    crosses = np.abs(vl) > 0.1
    reach = np.where(crosses, np.clip(-l / np.where(crosses, vl, 1.0), -10.0, 10.0), 10.0)
    columns = [s / 20.0, l / 4.0, vs / 10.0, vl / 2.0, c, sin, half_s, half_l, *changes]
    columns += [gap / 20.0, np.clip(gap, -5, 10) / 5.0, np.clip(room, -2, 4), np.clip(l, -4, 4)]
    columns += [(vs - speed) / 5.0, np.clip(gap / np.maximum(speed - vs, 0.5), -2, 10) / 4.0]
    columns += [reach / 5.0, np.clip(s / np.maximum(speed, 1.0), -2, 10) / 4.0]
    kinds = [kind == code for code in range(7)]
    return np.stack([*columns, *kinds], axis=-1), mask


def targets(arrays, name="plan"):
    """Speeds `(B, 8)` and offsets `(B, 5)` of recorded futures or plans, with their weights.

    Beyond the end of what is known, the offset is the last one, with a small weight: a car that
    stops before a knot keeps its offset.
    """
    future, known = arrays[name].astype(np.float64), arrays[f"{name}_known"]
    steps = np.rint(10 * KNOTS_S).astype(int) - 1
    s, l, _ = along_route(arrays["route"].astype(np.float64), arrays["route_mask"], future[..., :2])
    s = np.where(known, s, -np.inf)
    offsets, weights = np.zeros((len(s), len(KNOTS_M))), np.zeros((len(s), len(KNOTS_M)))
    rows = np.arange(len(s))
    for k, station in enumerate(KNOTS_M):
        nearest = np.abs(s - station).argmin(axis=1)  # of a plan that ends before: its end
        offsets[:, k] = l[rows, nearest]
        weights[:, k] = np.where(np.abs(s[rows, nearest] - station) < REACHED_M, 1.0, BEYOND)
    return future[:, steps, 4], known[:, steps], offsets, weights
