"""A chart: the speed over time."""

from replan import Chart
from replay.draw.charts.axes import Plane
from replay.draw.charts.canvas import polyline, text


def speed(subject):
    """The speed over time."""
    ego = subject.trace.ego
    plane = Plane(subject.span, (0.0, 30.0), 440.0, 200.0)
    line = polyline(plane.at_x(ego.t), plane.at_y(ego.v), "line a")
    body = plane.drawn(line, x_title="time [s]") + text(2.0, 13.0, "My speed [m/s]", "title")
    return Chart("my_speed", "My speed [m/s]", f"The speed ends at {ego.v[-1]:.1f} m/s", 440.0, 200.0, body)
