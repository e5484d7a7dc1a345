"""A chart: the speed over time."""

from replan.draw.charts.axes import Plane


def speed(subject):
    """The speed over time."""
    ego = subject.trace.ego
    plane = Plane(subject.span, (0.0, 30.0), 440.0, 200.0)
    says = f"The speed ends at {ego.v[-1]:.1f} m/s"
    return plane.chart(
        "my_speed",
        "My speed [m/s]",
        plane.line(ego.t, ego.v, "curve1"),
        says=says,
        x_title="time [s]",
    )
