"""The road beyond its end, for planners whose centre line ends with the route (PDM-Closed brakes to
a stand within a step there; nuPlan's maps do not end near a log).

Lanes of the route's last roadblock that lead nowhere go on straight for `BEYOND_M`, as the paths of
replan's own planners do; with the same limit, width and neighbours, as a roadblock of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .nuplan_channel import Message, points

BEYOND_M = 250.0
AIM_M = 3.0
"""The direction of a lane's end is that of its last this many metres, or of all of it."""
JUNCTION = "intersection"


def with_road_beyond(context: Message) -> Message:
    """A copy of `hello.context` whose route does not end with the road; unchanged if it does not,
    or if there is no route.
    """
    rows = {row["id"]: row for row in context["road"]["lanes"] if row["drivable"]}
    route = context["route"]["lanes"]
    last = rows.get(route[-1]) if route else None
    if last is None or _leads_on(last, rows):
        return context
    ends = [row for row in rows.values() if row["group"] == last["group"]]
    ends = [row for row in ends if not _leads_on(row, rows)]
    first_id = max(row["id"] for row in context["road"]["lanes"]) + 1
    group = max(row["group"] for row in rows.values()) + 1
    name = {row["id"]: first_id + k for k, row in enumerate(ends)}
    beyond = [_beyond(row, name, group) for row in ends]
    lanes = [
        {**row, "successors": [name[row["id"]]]} if row["id"] in name else row
        for row in context["road"]["lanes"]
    ]
    road = {**context["road"], "lanes": lanes + beyond}
    assumed = road.get("assumed_limits", [])
    road["assumed_limits"] = [*assumed, *(new for old, new in name.items() if old in assumed)]
    longer = {**context["route"], "lanes": [*route, name[last["id"]]]}
    return {**context, "road": road, "route": longer}


def _leads_on(row: Message, rows: dict[int, Message]) -> bool:
    return any(after in rows for after in row["successors"])


def _beyond(row: Message, name: dict[int, int], group: int) -> Message:
    """The lane behind the end of one."""
    left, right = points(row["left"]), points(row["right"])
    step = BEYOND_M * _direction(0.5 * (left + right))
    line = points(row["line"])[-1:]
    return {
        **row,
        "id": name[row["id"]],
        "left": _sent(np.vstack([left[-1], left[-1] + step])),
        "right": _sent(np.vstack([right[-1], right[-1] + step])),
        "line": _sent(np.vstack([line, line + step])),
        "successors": [],
        "left_neighbour": name.get(row["left_neighbour"]),
        "right_neighbour": name.get(row["right_neighbour"]),
        "group": group,
        "kind": "+".join(word for word in row["kind"].split("+") if word != JUNCTION),
    }


def _direction(center: NDArray[np.float64]) -> NDArray[np.float64]:
    """The unit vector of a line's end."""
    distance = np.hypot(*(center[-1] - center).T)
    far = np.flatnonzero(distance >= AIM_M)
    begin = int(far[-1]) if len(far) else int(np.argmax(distance))
    step = center[-1] - center[begin]
    return step / np.hypot(*step)


def _sent(line: NDArray[np.float64]) -> bytes:
    return np.asarray(line, "<f8").tobytes()
