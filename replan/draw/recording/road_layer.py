"""The road, its rules and the goal, written once; and the lights as they change."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr

from replan.core.arrays import BoolArray, FloatArray, IntArray, arc_lengths
from replan.core.kernel import kernel
from replan.draw.recording import colours
from replan.draw.recording.tape import Instants, PlaneWindow, Tape, joined, strips, strokes
from replan.logs.polylines import inside
from replan.logs.road import Lane, Road
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario

DASH_M, GAP_M = 3.0, 6.0
BESIDE_M = 0.3  # Distance beside a boundary at which another lane is looked for
LIGHTS = {
    Colour.RED: 0xFF4B3CFF,
    Colour.RED_YELLOW: 0xFF963CFF,
    Colour.YELLOW: 0xFFD250FF,
    Colour.GREEN: 0x50DC78FF,
    Colour.OFF: 0x787D87FF,
}
STOP_SIGN = 0xFF6E64FF
LAMP_M, LAMP_HEIGHT_M = 0.45, 1.2
# Height of the goal's name: it appears above the region, as seen from behind the ego
GOAL_NAME_M = 8.0


def at_height(points: FloatArray, z: float) -> FloatArray:
    """Plane points `(n, 2)` as points of the scene `(n, 3)`."""
    return np.column_stack([points, np.full(len(points), z)])


def draw_lines(
    tape: Tape, entity: str, lines: Sequence[FloatArray], colour: int, radius: float, z: float
) -> None:
    """Static polylines `(n, 2)`."""
    if not lines:
        return
    points, lengths = joined(lines, 2)
    drawn = rr.LineStrips3D(strips(at_height(points, z), lengths), colors=colour, radii=radius)
    tape.static(entity, drawn)


def dashes(line: FloatArray) -> list[FloatArray]:
    """The dashes of a broken marking along a polyline `(n, 2)`."""
    along = arc_lengths(*line.T)
    pieces: list[FloatArray] = []
    for start in np.arange(0.0, along[-1], DASH_M + GAP_M):
        stop = min(start + DASH_M, along[-1])
        inner = along[(along > start) & (along < stop)]
        s = np.r_[start, inner, stop]
        pieces.append(np.column_stack([np.interp(s, along, column) for column in line.T]))
    return pieces


def draw_road(tape: Tape, road: Road) -> None:
    """Surfaces, edges (white), markings between lanes (broken if they may be crossed), lines to
    opposite lanes.

    If lanes overlap, as in a junction, their edges are not edges of the road, and are drawn faint.
    Stop lines are white, those of a stop sign red; crosswalks are hatched.
    """
    lanes = tuple(road.lanes.values())
    for entity, of_kind, colour, z in (
        ("world/road/surface", [lane for lane in lanes if lane.drivable], colours.SURFACE, -0.04),
        ("world/road/walk", [lane for lane in lanes if not lane.drivable], colours.WALK, -0.03),
    ):
        vertices, triangles, count = list[FloatArray](), list[IntArray](), 0
        for lane in of_kind:  # strips of triangles between its boundaries
            n = len(lane.left)
            left, right = np.arange(n - 1) + count, np.arange(n - 1) + count + n
            triangles += [
                np.column_stack([left, right, left + 1]),
                np.column_stack([left + 1, right, right + 1]),
            ]
            vertices += [lane.left, lane.right]
            count += 2 * n
        if of_kind:
            points, indices = at_height(np.concatenate(vertices), z), np.concatenate(triangles)
            tape.static(
                entity,
                rr.Mesh3D(vertex_positions=points, triangle_indices=indices, albedo_factor=colour),
            )
    faint, edges, markings, opposite = (list[FloatArray]() for _ in range(4))
    for lane in lanes:  # the left boundary; the right one is the neighbour's left
        line = dashes(lane.left) if lane.left_crossable else [lane.left]
        if lane.left_opposite:
            opposite += line
        elif lane.left_neighbour in road.lanes:
            markings += line
    for drivable in (True, False):
        for on_another, piece in _edges(
            [lane for lane in lanes if lane.drivable is drivable], road
        ):
            (faint if on_another else edges).append(piece)
    draw_lines(tape, "world/road/faint", faint, colours.FAINT, 0.04, -0.01)
    draw_lines(tape, "world/road/edges", edges, colours.EDGE, 0.08, 0.0)
    draw_lines(tape, "world/road/markings", markings, colours.MARKING, 0.07, 0.0)
    draw_lines(tape, "world/road/opposite", opposite, colours.OPPOSITE, 0.07, 0.01)
    signed = [line.points for line in road.stop_lines if line.must_stop]
    others = [line.points for line in road.stop_lines if not line.must_stop]
    draw_lines(tape, "world/road/stop_lines", others, colours.EDGE, 0.2, 0.02)
    draw_lines(tape, "world/road/stop_signs", signed, STOP_SIGN, 0.2, 0.03)
    polygons = [crosswalk.polygon for crosswalk in road.crosswalks]
    _draw_hatched(tape, "world/road/crosswalks", polygons, colours.EDGE, 0.5)


def draw_lights(tape: Tape, scenario: Scenario, instants: Instants) -> None:
    """The lights as lamps above the middles of their stop lines, in their colours; grey: unknown,
    or off.

    A row is written when a colour changes.
    """
    lines = [line for line in scenario.road.stop_lines if line.light is not None]
    if not lines or not len(instants):
        return
    lights = {light.id: light for light in scenario.lights}
    shown = np.zeros((len(instants), len(lines)), np.uint32)
    ids = [line.light for line in lines if line.light is not None]
    for k, name in enumerate(ids):
        light = lights.get(name)
        for row, t in enumerate(instants.t):
            shown[row, k] = LIGHTS[Colour.OFF if light is None else light.at(float(t))]
    changed = np.r_[True, (shown[1:] != shown[:-1]).any(axis=1)]
    places = at_height(np.array([line.points.mean(axis=0) for line in lines]), LAMP_HEIGHT_M)
    count = int(changed.sum())
    lamps = rr.Points3D.columns(
        positions=np.tile(places, (count, 1)), colors=shown[changed].reshape(-1)
    )
    tape.static("world/lights", rr.Points3D.from_fields(radii=[LAMP_M]))
    changes = Instants(instants.t[changed], instants.frame[changed])
    tape.rows("world/lights", changes, lamps, np.full(count, len(lines)))


def _edges(lanes: Sequence[Lane], road: Road) -> Iterator[tuple[bool, FloatArray]]:
    """The boundaries without a lane beside them, in pieces, and whether a piece lies on another
    lane.
    """
    sides = list[tuple[int, FloatArray, float]]()
    for owner, lane in enumerate(lanes):
        if not lane.left_opposite and lane.left_neighbour not in road.lanes:
            sides.append((owner, lane.left, 1.0))
        if lane.right_neighbour not in road.lanes:
            sides.append((owner, lane.right, -1.0))
    if not sides:
        return
    outside = []
    for _, line, side in sides:
        along = np.diff(line, axis=0)
        length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)
        normal = np.column_stack([-along[:, 1], along[:, 0]]) / length[:, None]
        outside.append(0.5 * (line[:-1] + line[1:]) + side * BESIDE_M * normal)
    corners, lengths = joined([lane.polygon for lane in lanes], 2)
    boxes = np.array([[*lane.polygon.min(axis=0), *lane.polygon.max(axis=0)] for lane in lanes])
    owners = np.repeat([owner for owner, _, _ in sides], [len(points) for points in outside])
    on_another = covered(
        np.concatenate(outside), owners, corners, np.r_[0, np.cumsum(lengths)], boxes
    )
    begin = 0
    for (_, line, _), points in zip(sides, outside, strict=True):
        mask = on_another[begin : begin + len(points)]
        begin += len(points)
        cuts = np.flatnonzero(np.diff(mask)) + 1
        for start, stop in zip(np.r_[0, cuts], np.r_[cuts, len(mask)], strict=True):
            yield bool(mask[start]), line[start : stop + 1]


@kernel
def covered(
    points: FloatArray, owner: IntArray, corners: FloatArray, offsets: IntArray, boxes: FloatArray
) -> BoolArray:
    """Whether each point `(n, 2)` lies in a polygon other than its owner's.

    Args:
        points: m.
        owner: `(n,)` index of the polygon that is ignored for each point.
        corners: `(m, 2)` of all polygons; polygon k owns `offsets[k] : offsets[k + 1]`.
        offsets: `(k + 1,)`.
        boxes: `(k, 4)` lower x, lower y, upper x, upper y of each polygon.
    """
    is_covered = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        for k in range(len(boxes)):
            near = boxes[k, 0] <= x <= boxes[k, 2] and boxes[k, 1] <= y <= boxes[k, 3]
            if near and k != owner[i] and inside(x, y, corners[offsets[k] : offsets[k + 1]]):
                is_covered[i] = True
                break
    return is_covered


def draw_goal(tape: Tape, scenario: Scenario) -> None:
    """The goal's regions, outlined and hatched."""
    regions = [
        region for region in (scenario.goal.regions if scenario.goal else ()) if len(region) >= 3
    ]
    if not regions:
        return
    _draw_hatched(tape, "world/goal", regions, colours.GOAL, 1.0)
    points, _ = joined(regions, 2)
    center, colour = [*points.mean(axis=0), GOAL_NAME_M], colours.of_words(colours.GOAL)
    name = rr.Points3D([center], labels=["goal"], colors=colour, radii=0.01)
    tape.static("world/goal/name", name, rr.Points3D.from_fields(show_labels=True))


def _draw_hatched(
    tape: Tape, entity: str, polygons: Sequence[FloatArray], colour: int, spacing: float
) -> None:
    """Polygons outlined, and filled with strokes at least `spacing` m apart."""
    if not polygons:
        return
    rings = [np.vstack([polygon, polygon[:1]]) for polygon in polygons]
    draw_lines(tape, entity, rings, colour, 0.12, 0.03)
    filled: list[FloatArray] = []
    for polygon in polygons:
        (x0, y0), (x1, y1) = polygon.min(axis=0), polygon.max(axis=0)
        window = PlaneWindow((float(x0), float(x1)), (float(y0), float(y1)))
        lines, _ = strokes(
            polygon, np.array([len(polygon)]), window, max(spacing, (x1 - x0) / 200.0)
        )
        filled += list(lines)
    draw_lines(tape, f"{entity}/fill", filled, colours.with_alpha(colour, 90), 0.06, 0.02)
