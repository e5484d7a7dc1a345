"""CommonRoad files by hand."""

from math import cos, sin
from pathlib import Path

HEAD = (
    '<commonRoad timeStepSize="0.1" commonRoadVersion="{version}" benchmarkID="{benchmark}" '
    'source="{source}" {more}>'
)


def points(*xy: tuple[float, float]) -> str:
    return "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in xy)


def lanelet(
    name: int, left: str, right: str, inner: str = "", marks: tuple[str, str] = ("", "")
) -> str:
    bounds = (f"<lineMarking>{mark}</lineMarking>" if mark else "" for mark in marks)
    return (
        f'<lanelet id="{name}"><leftBound>{left}{next(bounds)}</leftBound>'
        f"<rightBound>{right}{next(bounds)}</rightBound>{inner}</lanelet>"
    )


def straight(name: int, y: float = 0.0, inner: str = "", marks: tuple[str, str] = ("", "")) -> str:
    left, right = (points(*((x, y + side) for x in (-50.0, 0.0, 200.0))) for side in (2.0, -2.0))
    return lanelet(name, left, right, inner, marks)


def exact(tag: str, value: float) -> str:
    return f"<{tag}><exact>{value!r}</exact></{tag}>"


def state(step: int, x: float, y: float, yaw: float, v: float, tag: str = "state") -> str:
    place = f"<position><point><x>{x!r}</x><y>{y!r}</y></point></position>"
    return f"<{tag}>{place}{exact('orientation', yaw)}{exact('time', step)}{exact('velocity', v)}</{tag}>"  # noqa: E501


RECTANGLE = "<rectangle><length>4.0</length><width>2.0</width></rectangle>"


def vehicle(
    name: int, rows: list[tuple[int, float, float, float, float]], shape: str = RECTANGLE
) -> str:
    later = "".join(state(*row) for row in rows[1:])
    first = state(*rows[0], tag="initialState")
    return (
        f'<dynamicObstacle id="{name}"><type>car</type><shape>{shape}</shape>{first}'
        f"<trajectory>{later}</trajectory></dynamicObstacle>"
    )


def driving(
    x: float, y: float, v: float, steps: int = 21, yaw: float = 0.0
) -> list[tuple[int, float, float, float, float]]:
    return [
        (k, x + v * 0.1 * k * cos(yaw), y + v * 0.1 * k * sin(yaw), yaw, v) for k in range(steps)
    ]


def problem(name: int, x: float, y: float, v: float, goal: str = "", step: int = 0) -> str:
    start = state(step, x, y, 0.0, v, tag="initialState")
    time = "<time><intervalStart>20</intervalStart><intervalEnd>30</intervalEnd></time>"
    return (
        f'<planningProblem id="{name}">{start}<goalState>{time}{goal}</goalState></planningProblem>'
    )


def written(
    folder: Path, *parts: str, version: str = "2020a", benchmark: str = "DEU_Test-1", **more: str
) -> Path:
    head = HEAD.format(
        version=version,
        benchmark=benchmark,
        source=more.pop("source", ""),
        more="".join(more.values()),
    )
    file = folder / "test.xml"
    file.write_text(head + "".join(parts) + "</commonRoad>")
    return file
