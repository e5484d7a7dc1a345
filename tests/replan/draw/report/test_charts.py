"""Charts: lines drawn as near as said and no nearer, axes with numbers, moments and violations that
the tables have.
"""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from itertools import pairwise
from math import isfinite, nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import assume, given, strategies as st
from hypothesis.extra import numpy as hnp
from typer.testing import CliRunner

from replan.cli import app
from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.draw.charts import Chart, curves, decisions, scenes, sl_graph, st_graph, subject
from replan.draw.charts.bird_view import BirdView, _plane
from replan.draw.charts.curves import decided, statuses
from replan.draw.charts.layout import charts_of
from replan.draw.charts.simplify import KEPT_PX, cut_line, cut_outline, simplified
from replan.draw.charts.style import DARK, DRIVES, LIGHT, RULES, stylesheet
from replan.draw.charts.subject import gravity, violations, worst_moment
from replan.draw.charts.svg import polyline, px, text
from replan.draw.drawn_results import Results, load
from replan.draw.spans import ticks
from replan.explain.drive_events import events
from replan.logs.mcap import read_moment, read_trace
from replan.logs.plan import Decision, DecisionKind, LaneOption, PlanStatus, PlanSummary
from replan.logs.states import EgoState
from replan.run import evaluate_logs

ROOT = Path(__file__).parents[4]
LOG = "paper/crossing_pedestrian"
PIXELS = st.floats(-500.0, 500.0)
LINES = hnp.arrays(np.float64, st.tuples(st.integers(2, 60), st.just(2)), elements=PIXELS)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Results:
    config = RunConfig(planners=("dp_qp", "constant_speed"), mode="closed", recording=False)
    return evaluate_logs((), config, tmp_path_factory.mktemp("results") / "run", suite=LOG)


# the layer under the charts -----------------------------------------------------------------------


@given(LINES)
def test_a_simplified_line_keeps_its_ends_within_the_tolerance(line: np.ndarray) -> None:
    kept = simplified(line)
    assert (kept[0], kept[-1]) == (0, len(line) - 1) and (np.diff(kept) > 0).all()
    for a, b in pairwise(kept):
        for k in range(a + 1, b):
            chord, away = line[b] - line[a], line[k] - line[a]
            length = np.hypot(*chord)
            distance = (
                abs(chord[0] * away[1] - chord[1] * away[0]) / length if length else np.hypot(*away)
            )
            assert distance <= KEPT_PX + 1e-9


def test_a_straight_line_is_two_points_and_a_spike_is_kept() -> None:
    straight = np.column_stack([np.arange(1000.0), 0.5 * np.arange(1000.0)])
    assert simplified(straight).tolist() == [0, 999]
    straight[500, 1] += 30.0
    assert 500 in simplified(straight)


@given(LINES)
def test_steps_between_rounded_points_do_not_add_errors(line: np.ndarray) -> None:
    drawn = re.search(r'd="([^"]*)"', polyline(line[:, 0], line[:, 1], "a"))
    assert drawn is not None
    numbers = [float(word) for word in re.findall(r"-?(?:\d+\.?\d*|\.\d+)", drawn[1])]
    assume("h" not in drawn[1])
    points = np.cumsum(np.array(numbers).reshape(-1, 2), axis=0)
    kept = np.rint(10.0 * line[simplified(line)]) / 10.0
    assert np.abs(points[-1] - kept[-1]).max() < 1e-6


def test_gaps_stay_gaps_and_numbers_are_short() -> None:
    t, values = np.arange(6.0), np.array([0.0, 10.0, nan, 30.0, 0.0, nan])
    assert polyline(t, values, "a").count("M") == 2
    assert [px(v) for v in (0.04, -0.04, 0.5, -1.25, 12.0, 1e9)] == [
        "0",
        "0",
        ".5",
        "-1.2",
        "12",
        "20000",
    ]


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.integers(2, 9))
def test_axes_have_two_numbers_or_more_and_not_too_many(low: float, span: float, most: int) -> None:
    assume(span > 1e-6 * abs(low))
    found = ticks(low, low + span, most)
    assert 2 <= len(found) <= 2 * most + 2
    assert (
        (np.diff(found) > 0.0).all()
        and found[0] >= low - 1e-6 * span
        and found[-1] <= low + span * (1.0 + 1e-6)
    )


def test_cutting_keeps_the_parts_inside_the_plot_area() -> None:
    square = np.array([[-1e5, -1e5], [1e5, -1e5], [1e5, 1e5], [-1e5, 1e5]])
    cut = cut_outline(square, 100.0, 50.0)
    assert (
        cut.min() >= -12.0 - 1e-6
        and cut[:, 0].max() <= 112.0 + 1e-6
        and cut[:, 1].max() <= 62.0 + 1e-6
    )
    small = square / 1e5 + 20.0
    np.testing.assert_array_equal(cut_outline(small, 100.0, 50.0), small)
    line = np.array(
        [[-900.0, 0.0], [-800.0, 0.0], [50.0, 10.0], [60.0, 10.0], [900.0, 10.0], [990.0, 900.0]]
    )
    assert [piece.tolist() for piece in cut_line(line, 100.0, 50.0)] == [line[1:5].tolist()]


def test_names_from_logs_are_escaped_in_svg() -> None:
    hostile = '</text><script>alert("1")</script>\n\x00'
    drawn = text(0.0, 0.0, hostile, about=hostile.replace("\x00", ""))
    assert "<script" not in drawn and "\x00" not in drawn
    ET.fromstring(drawn)


def _classes(rules: str) -> set[str]:
    return set(re.findall(r"\.([a-z]\w*)", re.sub(r"{.*?}|/\*.*?\*/", "", rules, flags=re.DOTALL)))


def test_each_class_of_the_style_is_used() -> None:
    """A chart names its classes in text, alone or with others."""
    words = {"chart", *DRIVES}
    for path in [*(ROOT / "replan").rglob("*.py"), *(ROOT / "studies").glob("*.py")]:
        source = path.read_text(encoding="utf-8")
        if "draw.charts" in source and path.name != "style.py":
            for quoted in re.findall(r'"([a-z][a-z_0-9 ]*)', source):
                words.update(quoted.split())
    assert not _classes(RULES) - words


def test_each_class_of_a_drawn_chart_has_a_style(run: Results) -> None:
    drives = [run.drive(LOG, planner) for planner in ("dp_qp", "constant_speed")]
    for seen in (subject(drives[0]), subject(drives[1]), subject(drives[0], 3.0, drives[1:])):
        for chart in charts_of(seen, "all", 1400):
            for names in re.findall(r'class="([^"]*)"', chart.body):
                assert set(names.split()) <= _classes(RULES), chart.name


def test_both_themes_have_the_same_roles_and_enough_contrast() -> None:
    assert (
        LIGHT.keys()
        == DARK.keys()
        == {*re.findall(r"\$(\w+)", RULES), "panel", "good", "unsure", "focus"}
    )
    for theme in (LIGHT, DARK):
        for role in ("ink", "muted", "ego", "plan", "other", "rare", "bad", "good", "unsure"):
            assert _contrast(theme[role], theme["ground"]) >= (
                4.5 if role in ("ink", "muted", "bad") else 3.0
            ), role
    assert "var(" not in stylesheet("dark") and "prefers-color-scheme" in stylesheet("auto")


def _contrast(one: str, two: str) -> float:
    """WCAG 2.1."""

    def light(colour: str) -> float:
        parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    high, low = sorted((light(one), light(two)), reverse=True)
    return (high + 0.05) / (low + 0.05)


# when to look -------------------------------------------------------------------------------------


def drive(
    verdicts: list[tuple[Any, ...]],
    metrics: list[tuple[Any, ...]],
    steps: dict[str, Any] | None = None,
) -> Any:
    """As much of a `DriveResult` as moments are made of."""
    said = pd.DataFrame(
        verdicts, columns=["gate", "outcome", "value", "time_s", "reason", "metric", "low", "high"]
    )
    found = pd.DataFrame(
        metrics, columns=["metric", "available", "value", "unit", "time_s", "reason"]
    )
    empty = np.empty(0), np.empty(0)
    return SimpleNamespace(
        verdicts=said,
        metrics=found,
        info={"t_end_s": 20.0},
        steps=lambda name: (steps or {}).get(name, empty),
    )


NEAR = [("gap.min", True, 0.8, "m", 7.0, "car 7"), ("ttc.min", True, 2.0, "s", 6.0, "")]
ALONE = [("gap.min", False, nan, "m", nan, "alone")]
BRAKES = (
    "lon_accel.worst_episode <= 1 [closed]",
    "fail",
    1.5,
    3.0,
    "",
    "lon_accel.worst_episode",
    nan,
    1.0,
)
HITS = (
    "collision_at_fault.count <= 0 [closed]",
    "fail",
    1.0,
    9.0,
    "car 7: with the front",
    "collision_at_fault.count",
    nan,
    0.0,
)


@pytest.mark.parametrize(
    ("verdicts", "metrics", "t", "why"),
    [
        (
            [BRAKES, HITS],
            NEAR,
            9.0,
            "collision_at_fault.count <= 0 [closed] fails: 1 (car 7: with the front)",
        ),
        ([BRAKES], NEAR, 3.0, "lon_accel.worst_episode <= 1 [closed] fails: 1.5"),
        (
            [(*HITS[:3], nan, "", *HITS[5:])],
            NEAR,
            6.0,
            "a gate fails, at no instant; least time to a collision: 2 s",
        ),
        (
            [(BRAKES[0], "pass", 0.0, 1.0, "", *BRAKES[5:])],
            NEAR,
            6.0,
            "no gate of this loop fails; least time to a collision: 2 s",
        ),
        (
            [],
            NEAR[:1],
            7.0,
            "no gate of this loop fails; least distance to another road user: 0.8 m (car 7)",
        ),
        ([], ALONE, 10.0, "no gate of this loop fails; no distance to others was measured"),
    ],
)
def test_the_worst_moment_is_that_of_the_gravest_failed_gate(
    verdicts: list[Any], metrics: list[Any], t: float, why: str
) -> None:
    moment = worst_moment(drive(verdicts, metrics))
    assert moment.t == t and moment.why.startswith(why)


def test_violations_are_the_steps_that_the_gate_counts() -> None:
    t = np.arange(8.0)
    steps = {
        "lon_accel": (t, np.array([0.0, -5.0, -6.0, nan, -6.0, 0.0, 3.0, 0.0])),
        "gap": (t, np.array([9.0, 3.0, 0.4, 0.3, 0.6, 1.0, 2.0, 3.0])),
        "tracking_lateral": (t, np.array([0.0, 0.0, -0.7, 0.0, 0.0, 0.0, 0.0, 0.6])),
    }
    verdicts = [
        ("a", "fail", 4.0, 1.0, "", "lon_accel.time_out_of_bounds", nan, 3.0),
        ("b", "fail", 0.3, 3.0, "", "gap.min", 0.5, nan),
        ("c", "fail", 0.7, 2.0, "", "tracking_lateral.max_abs", -1.0, 0.5),
        ("d", "fail", 0.0, 7.0, "", "goal.final", 1.0, nan),
        ("e", "pass", 0.0, 7.0, "", "speed.p95", nan, 1.0),
    ]
    found = {some.series: some.spans for some in violations(drive(verdicts, [], steps))}
    assert found == {
        # -4.05 and 2.40 m/s2; the step without a value parts nothing
        "lon_accel": ((1.0, 4.0), (6.0, 6.0)),
        "gap": ((2.0, 3.0),),
        "tracking_lateral": ((2.0, 2.0), (7.0, 7.0)),
        "goal": ((7.0, 7.0),),
    }


# a drive ------------------------------------------------------------------------------------------


def said(*kinds: DecisionKind | None) -> list[PlanSummary]:
    some = [
        () if kind is None else (Decision("ped 7", kind, "speed", f"why {i}"),)
        for i, kind in enumerate(kinds)
    ]
    status = [PlanStatus.PLANNED, PlanStatus.HARD_STOP]
    return [PlanSummary(0.1 * i, status[i > 2], "", inside) for i, inside in enumerate(some)]


def test_decisions_hold_until_the_next_frame() -> None:
    some = said(
        None, DecisionKind.YIELD, DecisionKind.YIELD, None, DecisionKind.STOP, DecisionKind.IGNORE
    )
    (row,) = decided(some, 1.0, str)
    spans = [(round(span.begin, 9), round(span.end, 9), span.word, span.why) for span in row.spans]
    assert spans == [(0.1, 0.3, "yield", "why 1"), (0.4, 0.5, "stop", "why 4")]
    ends = [(span.word, round(span.end, 9)) for span in statuses(some, 1.0).spans]
    assert ends == [("planned", 0.3), ("hard stop", 1.0)]
    assert decided([], 1.0, str) == [] and statuses([], 1.0).spans == ()


def test_read_moment_equals_the_moment_of_the_whole_trace(run: Results) -> None:
    file = load(run.path).drive(LOG, "dp_qp").trace_file
    (whole, _), (part, _, said) = read_trace(file), read_moment(file, 3.04)
    (frame,) = part.frames
    assert frame.t == whole.frames[30].t == pytest.approx(3.0) and len(frame.plan.internals) > 4
    for name in ("plan", "predictions"):
        assert repr(getattr(frame, name)) == repr(getattr(whole.frames[30], name))
    for one, other in zip(said, whole.frames, strict=True):
        told = tuple(
            item for item in other.plan.internals if isinstance(item, (Decision, LaneOption))
        )
        assert (one.t, one.status, one.reason, one.internals) == (
            other.t,
            other.plan.status,
            other.plan.reason,
            told,
        )
    assert events(part, said) == events(whole)
    assert read_moment(file, -1.0)[0].frames == ()


@pytest.mark.parametrize("planner", ["dp_qp", "constant_speed"])
def test_each_chart_is_svg_with_numbers_on_its_axes(run: Results, planner: str) -> None:
    seen = subject(load(run.path).drive(LOG, planner))
    charts = [*scenes(seen), st_graph(seen), sl_graph(seen), *curves(seen), decisions(seen)]
    wanted = {"st", "sl", "speed", "acceleration", "jerk", "steer", "pedals", "tracking"}
    assert {chart.name for chart in charts} >= wanted
    for chart in charts:
        root = ET.fromstring(chart.inline())
        words = [node.text or "" for node in root.iter() if node.tag == "text"]
        assert root.get("aria-label") == chart.says
        if planner == "constant_speed" and chart.name in ("st", "sl"):
            assert "constant_speed reports no internals" in words
        else:
            numbers = [word for word in words if re.fullmatch(r"\u2212?[\d.]+", word)]
            assert len(numbers) >= 2 and any("[" in word for word in words), chart.name
        assert not re.search(r"nan|inf\b|<script|id=", chart.body), chart.name


def test_broken_gates_are_shaded_and_named(run: Results) -> None:
    seen = subject(load(run.path).drive(LOG, "constant_speed"))
    by_name = {chart.name: chart for chart in curves(seen)}
    assert 'class="broken"' in by_name["ttc"].body and "\u26a0 ttc" in by_name["ttc"].body
    assert 'class="broken"' not in by_name["pedals"].body
    assert "collision_at_fault" in decisions(seen).body and ">fails<" in decisions(seen).body
    assert isfinite(seen.moment.t) and seen.moment.why.startswith("collision_at_fault")


def replan(*words: object) -> Any:
    return CliRunner(env={"COLUMNS": "200"}).invoke(app, [str(word) for word in words])


@pytest.mark.slow
def test_plot_writes_pictures(run: Results, tmp_path: Path) -> None:
    said = replan("plot", run.path, "-o", tmp_path / "a.png", "--width", 700)
    assert said.exit_code == 0 and "constant_speed, closed loop, at 8.2" in said.stdout
    assert "(the worst of 2 drives; another: --log, --planner, --mode)" in said.stdout
    data = (tmp_path / "a.png").read_bytes()
    assert data.startswith(b"\x89PNG") and int.from_bytes(data[16:20]) == 700
    again = ("--planner", "dp_qp", "--at", 6.5, "--chart", "st", "--theme", "dark")
    for name in ("b.svg", "c.svg"):
        assert replan("plot", run.path, *again, "-o", tmp_path / name).exit_code == 0
    drawn = (tmp_path / "b.svg").read_text(encoding="utf-8")
    assert drawn == (tmp_path / "c.svg").read_text(encoding="utf-8") and DARK["ground"] in drawn
    assert "pedestrian: yield" in "".join(ET.fromstring(drawn).itertext())
    assert (
        replan(
            "plot", run.path, "--planner", "dp_qp", "--chart", "scene", "-o", tmp_path / "each"
        ).exit_code
        == 0
    )
    names = sorted(file.name for file in (tmp_path / "each").iterdir())
    assert len(names) == 6 and names[0] == "paper_crossing_pedestrian-dp_qp-closed-scene_end.png"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--log", "paper/crosing"), "paper/crossing_pedestrian"),
        (("--planner", "idm"), "is called 'idm'"),
        (("--planner", "dp_qp", "--mode", "open"), "is called 'open'; known are: closed"),
        (("--planner", "dp_qp", "--at", 99), "--at 99 is not in its 0 to"),
        (("-o", "picture.pdf"), "a picture ends with .png or .svg"),
    ],
)
def test_an_impossible_plot_is_an_error_of_one_line(
    run: Results, words: tuple[Any, ...], line: str
) -> None:
    said = replan("plot", run.path, *words)
    assert said.exit_code == 2 and said.stderr.count("\n") == 1 and line in said.stderr


def test_a_chart_alone_is_a_file_with_its_style() -> None:
    chart = Chart("x", "a <b>", "says & so", 10.0, 20.0, "")
    root = ET.fromstring(chart.alone("light", 100.0))
    assert (root.get("width"), root.get("height"), root.get("viewBox")) == (
        "100",
        "200",
        "0 0 10 20",
    )


def test_drives_are_ranked_by_their_gravest_failed_gate() -> None:
    """Whatever the order in the file of gates: a collision, then safety, rules, progress, and all
    else.
    """
    rules = [
        "fallback.rate <= 0.01",
        "lon_accel.worst_episode <= 1 [closed]",
        "goal.final >= 1 [closed]",
        "red_light.count <= 0 [closed]",
        "gap_kept.time_below_20cm <= 0 [closed]",
        "collision_at_fault.count <= 0 [closed]",
    ]
    assert sorted(rules, key=gravity) == [*rules[:1:-1], *rules[:2]]


def test_several_drives_of_a_log_are_in_one_picture_and_told_apart(run: Results) -> None:
    result = load(run.path)
    drive, other = result.drive(LOG, "dp_qp"), result.drive(LOG, "constant_speed")
    seen = subject(drive, 3.0, [other])
    assert (
        list(seen.drives) == ["dp_qp", "constant_speed"]
        and seen.drives["constant_speed"].moment.t == 3.0
    )
    by_name = {chart.name: chart for chart in curves(seen)}
    assert {
        "speed",
        "acceleration_ego",
        "acceleration_lat_accel",
        "steer",
        "progress",
    } <= by_name.keys()
    for chart in (*by_name.values(), *scenes(seen)):
        root = ET.fromstring(chart.inline())
        words = "".join(root.itertext())
        assert "dp_qp" in words and "constant_speed" in words, chart.name
        assert not re.search(r"nan|inf\b|<script|id=", chart.body), chart.name
    assert 'class="drive1"' in by_name["speed"].body and 'class="drive2"' in by_name["speed"].body
    assert (
        "\u26a0 constant_speed: ttc" in by_name["ttc"].body
        and "constant_speed: collision" in by_name["gap_gap"].says
    )
    assert [chart.body.count('class="ego"') for chart in scenes(seen)] == [2, 2, 2]
    single = {chart.name for chart in charts_of(subject(drive, 3.0), "all", 1400)}
    both = charts_of(seen, "all", 1400)
    assert {"st", "sl"} <= single & {chart.name for chart in both}
    assert {chart.width for chart in both if chart.name in ("st", "sl")} == {440.0 + 16.0 + 440.0}
    assert sum(chart.name.startswith("st") for chart in charts_of(seen, "st", 800)) == 2


def test_a_drive_that_ended_is_shown_where_it_ended(run: Results) -> None:
    result = load(run.path)
    drives = [result.drive(LOG, name) for name in ("dp_qp", "constant_speed")]
    first, last = sorted(drives, key=lambda one: one.info["t_end_s"])
    at = last.info["t_end_s"]
    if at - first.info["t_end_s"] > 0.1:
        seen = subject(last, at, [first])
        assert seen.beside[0].moment.t == first.info["t_end_s"]
        assert ": ended" in scenes(seen)[-1].body


def test_drives_of_different_logs_in_one_picture_are_refused(run: Results) -> None:
    result = load(run.path)
    drive, other = result.drive(LOG, "dp_qp"), result.drive(LOG, "constant_speed")
    strange = replace(other, log="paper/free_road")
    for beside, words in (
        ([drive], "given twice"),
        ([other] * 4, "at most 4"),
        ([strange], "one picture is of one log"),
    ):
        with pytest.raises(ConfigError, match=words):
            subject(drive, 3.0, beside)


def test_plot_draws_several_planners_and_so_does_the_drive(run: Results, tmp_path: Path) -> None:
    asked = ("-p", "dp_qp", "-p", "constant_speed", "-p", "dp_qp", "--at", 3, "--chart", "curves")
    said = replan("plot", run.path, *asked, "-o", tmp_path / "two.svg")
    assert said.exit_code == 0 and "dp_qp, constant_speed, closed loop, at 3.00 s" in said.stdout
    drives = [load(run.path).drive(LOG, name) for name in ("dp_qp", "constant_speed")]
    chart = drives[0].plot(3.0, "curves", beside=drives[1:])
    assert (tmp_path / "two.svg").read_text(encoding="utf-8") == chart.alone("auto", 1400)
    chart.save(str(tmp_path / "by_text.svg"), theme="auto", width=1400)
    assert (tmp_path / "by_text.svg").read_text(encoding="utf-8") == chart.alone("auto", 1400)
    assert (
        replan("plot", run.path, *asked[:4], "--chart", "st", "-o", tmp_path / "each").exit_code
        == 0
    )
    names = sorted(file.name for file in (tmp_path / "each").iterdir())
    assert names == [
        f"paper_crossing_pedestrian-dp_qp-constant_speed-closed-st{end}" for end in (".png", ".svg")
    ]
    refused = replan("plot", run.path, "-p", "dp_qp", "-p", "idm")
    assert refused.exit_code == 2 and "no closed loop of idm" in refused.stderr


@given(
    st.floats(-np.pi, np.pi),
    st.floats(0.0, 30.0),
    st.lists(st.tuples(st.floats(-55.0, 55.0), st.floats(-55.0, 55.0)), max_size=4),
)
def test_a_scene_reaches_to_the_agents_that_its_sentence_names(
    yaw: float, speed: float, places: list[tuple[float, float]]
) -> None:
    ego = EgoState(0.0, 5.0, -7.0, yaw, speed, 0.0, 0.0)
    points = np.array(places).reshape(-1, 2) + np.array([ego.x, ego.y])
    view = BirdView(_plane(ego, [ego], points), ego)
    wide, high = view.plane.inner
    for x, y in view.of(points).tolist():
        assert 0.0 <= x <= wide and 0.0 <= y <= high


def test_the_agent_of_the_failed_gate_is_named_though_no_plan_decides_about_it(
    run: Results,
) -> None:
    drawn = subject(run.drive(LOG, "constant_speed"))
    assert not drawn.frame or not drawn.frame.plan.internals
    assert drawn.moment.about.startswith("pedestrian pedestrian: ")
    assert drawn.named_agents == {"pedestrian"}
    assert (
        replace(drawn, moment=replace(drawn.moment, about="pedestrian ped")).named_agents == set()
    )


def test_curves_of_a_closed_loop_have_those_of_the_log(tmp_path: Path) -> None:
    config = RunConfig(planners=("constant_speed",), recording=False)
    both = evaluate_logs((), config, tmp_path / "run", suite=LOG)
    closed, open_loop = (subject(both.drive(LOG, mode=mode)) for mode in ("closed", "open"))
    assert closed.logged is not None
    np.testing.assert_array_equal(closed.logged.v, open_loop.trace.ego.v)
    speed = next(chart for chart in curves(closed) if chart.name == "speed")
    assert "log " in speed.says
    assert "log " not in next(chart for chart in curves(open_loop) if chart.name == "speed").says
