"""Reports: JUnit XML against its schema and another parser, Markdown through a parser, the terminal
with any name.
"""

import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pandas as pd
import pytest
import xmlschema
from handmade import drive, lanes_along, scenario, straight, track, tracks
from hypothesis import given, strategies as st
from junitparser import Error, Failure, JUnitXml, Skipped, TestSuite
from markdown_it import MarkdownIt
from rich.table import Table
from rich.text import Text
from short_logs import free_and_blocked, short
from typer.testing import CliRunner

from replan.cli import app
from replan.config import RunConfig
from replan.core.names import counted, visible_name
from replan.draw.drawn_results import Results, load
from replan.draw.report.console import SafeConsole, visible, wrapped
from replan.draw.report.overview import MOST_FIRST, failure_lines, merged_notes, overview
from replan.draw.report.section import Cell, ReportColumn, ReportSection
from replan.draw.report.terminal import print_report
from replan.draw.report.write import (
    STEP_BYTES,
    JunitCase,
    append_step_summary,
    junit,
    junit_xml,
    markdown,
    section_text,
    shortened,
    write_reports,
)
from replan.logs.mcap import write_scenario
from replan.metrics.comparison import (
    FLIP_COLUMNS,
    GROUP_COLUMNS,
    PAIR_COLUMNS,
    Comparison,
    RuleVerdict,
)
from replan.metrics.judge.gates import Outcome
from replan.results.tables import REPORTS
from replan.run import evaluate_logs

HOSTILE = "a|b <script>alert(1)</script> `x` *y* _z_ [k](http://e.org) &lt; ]]> \x01\n# h"
SCHEMA = xmlschema.XMLSchema(Path(__file__).parents[3] / "support" / "junit.xsd")
MODES = ("open", "closed")
PLANNERS = ("constant_speed", "logged")
GATES = """
[[gate]]
metric = "collision_at_fault.count"
max = 0

[[gate]]
metric = "gap.min"
min = 0.5

[[gate]]
metric = "goal.final"
min = 1
over = "pass_share"
min_share = 0.5
max_missing = 0.5

[[gate]]
metric = "coverage.driven_s.final"
over = "sum"
min = 3600

[[gate]]
metric = "fallback.rate"
max = 0
planner = "constant_sped"
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """A log that passes, one with a crash, one with a hostile name, and one that cannot be read."""
    folder = tmp_path_factory.mktemp("logs")
    free, blocked = free_and_blocked()
    write_scenario(folder / "a.mcap", replace(free, tags=("rain",)))
    write_scenario(folder / "b.mcap", blocked)
    write_scenario(folder / "c.mcap", replace(free, name=HOSTILE))
    (folder / "d.mcap").write_bytes((folder / "a.mcap").read_bytes()[:-100])
    (folder / "gates.toml").write_text(GATES, encoding="utf-8")
    config = RunConfig(planners=PLANNERS, recording=False, gates=str(folder / "gates.toml"))
    return evaluate_logs([folder], config, tmp_path_factory.mktemp("out") / "run")


def parsed(results: Results, comparison: Comparison | None = None) -> dict[str, TestSuite]:
    text = junit(overview(results, comparison))
    SCHEMA.validate(text)
    return {suite.name: suite for suite in JUnitXml.fromstring(text.encode())}


def kinds(suite: TestSuite, *, gates: bool) -> Counter[str]:
    """How the tests of single logs ended: those of gates, or whether a log was evaluated."""
    found: Counter[str] = Counter()
    for case in suite:
        if "all logs" not in case.classname and (case.name != "evaluated") is gates:
            found[type(case.result[0]).__name__ if case.result else "pass"] += 1
    return found


def test_the_terminal_names_the_loop_of_each_verdict(results: Results, tmp_path: Path) -> None:
    over, written = overview(results), StringIO()
    print_report(over, SafeConsole(file=written, width=400), tmp_path)
    assert {row.mode for row in over.gates} >= set(MODES)
    bad = [row for row in over.gates if row.mode and row.outcome != "pass"]
    assert bad and all(f"{row.rule} [{row.mode}]" in written.getvalue() for row in bad)


def test_the_terminal_begins_with_the_verdict_and_ends_with_the_outcome(
    results: Results, tmp_path: Path
) -> None:
    over, written = overview(results), StringIO()
    print_report(over, SafeConsole(file=written, width=80), tmp_path)
    lines = [line.rstrip() for line in written.getvalue().splitlines()]
    assert lines[0].startswith(f"{over.outcome.upper()}: ")
    assert lines[-1] == f"Outcome: {over.outcome.upper()} (exit code {over.exit_code})"
    titles = [lines.index(title) for title in ("Gates", "Logs that pass", "Drives")]
    assert titles == sorted(titles)
    text = " ".join(" ".join(lines).split())
    notes = list(merged_notes(results.summary["logs"]))
    assert f"{counted(len(notes), 'note')} (summary.json)" in text or not notes
    assert "p50" not in text and not any(note in text for note in notes)


def test_each_failure_has_a_line_with_log_loop_rule_value_and_reason(results: Results) -> None:
    lines = dict(failure_lines(overview(results)))
    assert lines
    verdicts = results.verdicts.set_index(["gate", "log", "planner", "mode"])
    short = {str(log) for log in results.labels}
    for (gate, log, planner, mode), line in lines.items():
        row = verdicts.loc[(gate, log, planner, mode)]
        assert log in short and line.startswith(f"{log} ({planner}, {mode} loop): {gate}: ")
        assert f"{row['value']:.4g}" in line and str(row["reason"] or "") in line
    suites = parsed(results)
    messages = {
        case.result[0].message
        for suite in suites.values()
        for case in suite
        if case.result and isinstance(case.result[0], Failure)
    }
    assert {visible_name(line) for line in lines.values()} <= {visible_name(m) for m in messages}


def test_junit_counts_equal_the_tables(results: Results) -> None:
    suites = parsed(results)
    assert set(suites) == {"run", *(f"{planner}.{mode}" for planner in PLANNERS for mode in MODES)}
    for planner in PLANNERS:
        for mode in MODES:
            suite, said = suites[f"{planner}.{mode}"], results.verdicts
            mine = said[
                (said["planner"] == planner)
                & (said["mode"] == mode)
                & said["gate"].str.match("(collision|gap)")
            ]
            driven = mine[mine["log"].isin(list(results.labels))]
            outcomes = Counter(driven["outcome"])
            expected = {
                "Failure": outcomes["fail"],
                "Skipped": outcomes["inconclusive"],
                "pass": outcomes["pass"],
            }
            assert kinds(suite, gates=True) == Counter(expected)
            assert kinds(suite, gates=False) == {"pass": 3, "Error": 1}
            assert suite.errors == 1 and suite.tests == len(list(suite))
            results_of = [type(case.result[0]) for case in suite if case.result]
            assert (suite.failures, suite.skipped) == (
                results_of.count(Failure),
                results_of.count(Skipped),
            )
    assert parsed(results)["constant_speed.closed"].failures > 0


def test_a_junit_failure_names_log_time_and_agent(results: Results) -> None:
    suites = parsed(results)
    (crash,) = (
        case
        for case in suites["constant_speed.closed"]
        if case.name == "collision_at_fault.count <= 0"
        and case.result
        and isinstance(case.result[0], Failure)
    )
    assert crash.classname == "constant_speed.closed.test/blocked"
    assert "wall" in crash.result[0].message and " s: " in crash.result[0].message
    (broken,) = (
        case
        for case in suites["constant_speed.open"]
        if case.result and isinstance(case.result[0], Error)
    )
    assert "d.mcap" in broken.result[0].message
    driven = [
        case
        for case in suites["constant_speed.closed"]
        if case.name == "evaluated" and not case.result
    ]
    assert [case.time for case in driven] == pytest.approx(
        results.drives.query("planner == 'constant_speed' and mode == 'closed'")[
            "t_end_s"
        ].tolist(),
        abs=1e-3,
    )


def test_a_gate_over_all_logs_is_one_junit_test(results: Results) -> None:
    suites = parsed(results)
    together = {
        case.name: case
        for case in suites["constant_speed.closed"]
        if case.classname.endswith(".all logs")
    }
    hour, share = (
        together["sum coverage.driven_s.final >= 3600"],
        together["goal.final >= 1 in 50 % of logs"],
    )
    assert isinstance(hour.result[0], Failure) and "below 3600" in hour.result[0].message
    # Two of four: the log that could not be read counts against, and half are enough
    assert not share.result
    (misspelt,) = suites["run"]
    assert (
        isinstance(misspelt.result[0], Skipped)
        and "did you mean 'constant_speed'" in misspelt.result[0].message
    )


@pytest.mark.slow
def test_a_planner_that_crashes_is_an_error_and_counts_against(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "crashing.py").write_text(
        "from replan.planners.constant_speed import ConstantSpeed\n\n\nclass "
        "Crashing(ConstantSpeed):\n"
        "    def plan(self, frame):\n        if len(frame.agents):\n            raise "
        "RuntimeError('out of ideas')\n"
        "        return super().plan(frame)\n"
    )
    (tmp_path / "gates.toml").write_text('[[gate]]\nmetric = "coverage.log_s.final"\nmin = 1\n')
    config = RunConfig(
        planners=("crashing:Crashing",),
        mode="open",
        recording=False,
        gates=str(tmp_path / "gates.toml"),
    )
    logs = [tmp_path / "free.mcap", tmp_path / "crossed.mcap"]
    ego = drive(straight, 8.0, 2.0)
    other = tracks(track("car", [0.0, 2.0], [60.0, 60.0], [20.0, 20.0]))
    for log, agents in zip(logs, (None, other), strict=True):
        write_scenario(
            log, replace(scenario(ego, agents=agents, road=lanes_along(ego)), name=log.stem)
        )
    found = evaluate_logs(logs, config, tmp_path / "out")
    over = overview(found)
    assert over.exit_code == 3 and {gate.outcome for gate in over.gates} == {"inconclusive"}
    assert over.whole[["logs", "passed", "missing"]].to_numpy().tolist() == [[2, 1, 1]]
    suite = parsed(found)["crashing:Crashing.open"]
    (broken,) = (case for case in suite if case.result and case.name == "evaluated")
    assert isinstance(broken.result[0], Error) and "out of ideas" in broken.result[0].message
    assert broken.classname.endswith(".crossed")


@given(st.text(max_size=30))
def test_any_name_is_legal_xml(name: str) -> None:
    case = JunitCase(f"x.{name}", f"y{name}", "fail", name)
    (suite,) = JUnitXml.fromstring(junit_xml({f"z{name}": [case]}, "1", "2").encode())
    assert [case.result[0].type for case in suite] == ["fail"]


# Markdown -----------------------------------------------------------------------------------------


def tables(text: str) -> list[list[list[str]]]:
    """The tables of a Markdown text as a parser sees them: rows of cells, the head first."""
    found: list[list[list[str]]] = []
    tokens = iter(MarkdownIt("gfm-like", {"linkify": False}).parse(text))
    for token in tokens:
        if token.type == "table_open":
            found.append([])
        elif token.type == "tr_open":
            found[-1].append([])
        elif token.type == "inline" and found and token.map and found[-1] and token.level >= 4:
            found[-1][-1].append("".join(_words(token.children or [])))
    return found


def _words(children: list[object]) -> Iterator[str]:
    return (child.content for child in children if child.type in ("text", "text_special"))  # type: ignore[attr-defined]


def table(text: str, first: str) -> list[list[str]]:
    """The table with this head."""
    return next(rows for rows in tables(text) if rows[0][0] == first)


def test_markdown_tables_are_those_of_the_overview(results: Results) -> None:
    over = overview(results)
    text = markdown(over)
    for rows in tables(text):
        assert len({len(row) for row in rows}) == 1
    gates = [row for rows in tables(text) if rows[0][0] == "outcome" for row in rows[1:]]
    assert [row[0].lower() for row in gates] == [gate.outcome for gate in over.gates]
    assert all(row[1].startswith(gate.rule) for row, gate in zip(gates, over.gates, strict=True))
    shares = table(text, "logs")
    assert [row[3] for row in shares[1:3]] == [
        f"{share.passed} of {share.logs}" for share in over.whole.itertuples()
    ]
    assert 0 < len(over.first) <= MOST_FIRST and all(row.verdict != "pass" for row in over.first)
    look = next(line for line in text.splitlines() if line.startswith("Look first at"))
    assert all(row.planner in look for row in over.first)
    drives = table(text, "log")
    assert len(drives) - 1 == len(over.drives) == 6
    assert drives[1][:3] == ["test/blocked", "constant_speed", "FAIL 5/5"]  # the worst first
    assert "closed loop ended by" in drives[0] and len(drives[0]) == len(over.columns) + 4


def test_a_long_table_of_drives_folds_all_but_the_worst(results: Results) -> None:
    over = overview(results)
    rows = [replace(over.drives[i % 6], log=f"log{i}") for i in range(60)]
    many = replace(over, drives=sorted(rows, key=lambda row: row.rank))
    shown, folded = (rows[1:] for rows in tables(markdown(many)) if rows[0][0] == "log")
    assert (len(shown), len(folded)) == (25, 35)
    weight = {"FAIL": 0, "inconclusive": 1, "-": 2, "pass": 3}
    order = [weight[row[2].split()[0]] for row in (*shown, *folded)]
    assert order == sorted(order) and order[0] == 0


def test_a_hostile_name_is_escaped_in_markdown(results: Results) -> None:
    text = markdown(overview(results))
    names = {row[0] for row in table(text, "log")[1:]}
    assert names == {"test/free", "test/blocked", visible_name(HOSTILE)}
    html = MarkdownIt("gfm-like", {"linkify": False}).render(text)
    assert "<script>" not in html and 'href="http' not in html and "<h1>h" not in html
    assert html.count("<details>") == html.count("</details>") > 0


@given(st.text(alphabet=st.characters(exclude_categories=("Cs",)), max_size=40))
def test_any_text_is_shown_unchanged_in_a_markdown_cell(words: str) -> None:
    plain = " ".join(
        "".join(
            c if c.isprintable() or c.isspace() else "\N{REPLACEMENT CHARACTER}" for c in words
        ).split()
    )
    columns = (ReportColumn("a", Cell), ReportColumn("b", lambda row: Cell("last")))
    ((_, row),) = tables(section_text(ReportSection("title", columns, [words])))
    assert row == [plain, "last"]


def test_links_of_a_report_lead_to_existing_files(results: Results) -> None:
    out = results.path
    write_reports(overview(results), out)
    tokens = MarkdownIt("gfm-like", {"linkify": False}).parse(
        (out / "report.md").read_text(encoding="utf-8")
    )
    links = [
        str(c.attrs["href"]) for t in tokens for c in t.children or [] if c.type == "link_open"
    ]
    assert "junit.xml" in links and any("/closed." in link for link in links)
    assert all((out / link).is_file() for link in links)


def test_a_failed_rule_of_comparison_fails_the_report(results: Results) -> None:
    drive, numbers = (
        ("test/free", "logged", "closed", "gap.min", "m", "higher"),
        (1.0, 0.5, -0.5, 0.5, 0.5),
    )
    pairs = pd.DataFrame(
        [(*drive, *numbers, True, False, 3.2, "car 7")], columns=list(PAIR_COLUMNS)
    )
    verdicts = (RuleVerdict("no flips", Outcome.FAIL, "2 flips | of 3"),)
    groups, flips = (
        pd.DataFrame(columns=list(GROUP_COLUMNS)),
        pd.DataFrame(columns=list(FLIP_COLUMNS)),
    )
    found = Comparison(
        "main", "mine", ("code: 1 -> 2",), (), (), pairs, flips, groups, verdicts=verdicts
    )
    text = markdown(overview(results, found))
    assert "main -> mine" in text and "code: 1 -> 2" in text
    assert ["FAIL", "no flips", "2 flips | of 3"] in [row for rows in tables(text) for row in rows]
    moved = next(rows for rows in tables(text) if "metric" in rows[0])
    assert moved[1][:3] == ["test/free", "closed", "gap.min"]
    assert parsed(results, found)["compare"].failures == 1
    passed = replace(results, summary={**results.summary, "exit_code": 0, "outcome": "pass"})
    assert (overview(passed, found).exit_code, overview(passed, found).outcome) == (1, "fail")
    assert overview(results, found).exit_code == 3


def test_the_step_summary_is_appended_without_links(results: Results, tmp_path: Path) -> None:
    step = tmp_path / "summary.md"
    step.write_text("before\n", encoding="utf-8")
    append_step_summary(overview(results), {"GITHUB_STEP_SUMMARY": str(step)})
    append_step_summary(overview(results), {})
    text = step.read_text(encoding="utf-8")
    assert text.startswith(
        "before\n# replan: not all could be evaluated"
    ) and "](" not in text.replace("\\](", "")


@given(st.integers(0, 3000))
def test_a_long_summary_is_cut_between_lines_with_a_note(most: int) -> None:
    text = "# head\n\n<details>\n<summary>x</summary>\n\n" + "| é | b |\n" * 200 + "\n</details>\n"
    short = shortened(text, most)
    assert len(short.encode()) <= most
    if len(text.encode()) <= most:
        assert short == text
    elif short:
        assert "shortened" in short and short.count("<details>") == short.count("</details>")
        assert all(line in text or "shortened" in line for line in short.splitlines())


def test_the_limit_of_a_step_summary_counts_its_present_contents(
    results: Results, tmp_path: Path
) -> None:
    step = tmp_path / "summary.md"
    step.write_bytes(b"x" * (STEP_BYTES - 2000))
    append_step_summary(overview(results), {"GITHUB_STEP_SUMMARY": str(step)})
    assert STEP_BYTES - 2000 < step.stat().st_size <= STEP_BYTES
    assert "This report is shortened" in step.read_text(encoding="utf-8")


def test_reports_do_not_depend_on_the_place_of_the_folder(results: Results, tmp_path: Path) -> None:
    shutil.copytree(results.path, tmp_path / "elsewhere" / "run")
    both = (results, load(tmp_path / "elsewhere/run"))
    for found in both:
        write_reports(overview(found), found.path)
    for before, after in ([found.path / name for found in both] for name in REPORTS):
        assert before.read_bytes() == after.read_bytes()
        for place in (results.path, *{Path(source).parent for source in results.logs["source"]}):
            assert str(place).encode() not in before.read_bytes()


def test_replan_report_writes_into_the_folder_of_its_option(
    results: Results, tmp_path: Path
) -> None:
    clean = {key: None for key in os.environ if key.startswith("GITHUB_")}
    done = CliRunner(env=clean).invoke(
        app, ["report", str(results.path), "-o", str(tmp_path / "reports")]
    )
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in (tmp_path / "reports").iterdir()) == [
        "junit.xml",
        "report.html",
        "report.md",
    ]
    assert "](" not in (tmp_path / "reports/report.md").read_text(encoding="utf-8").replace(
        "\\](", ""
    )
    assert CliRunner(env=clean).invoke(app, ["report", str(tmp_path / "nowhere")]).exit_code == 2


EVIL = "\x1b[2J\x1b]0;title\x07\r\x9b31mpaper/\u202egnp\x7f"
RAW = ("\x1b[2J", "\x1b]0", "\x07", "\r", "\x9b", "\u202e", "\x7f")


@given(text=st.text())
def test_visible_replaces_control_characters_alone(text: str) -> None:
    seen = visible(text)
    assert len(seen) == len(text) and visible(seen) == seen
    assert not any((ord(c) < 32 and c not in "\n\t") or 0x7F <= ord(c) < 0xA0 for c in seen)
    assert all(a == b for a, b in zip(text, seen, strict=True) if a.isprintable())


@given(
    words=st.lists(st.text("ab-", min_size=1, max_size=9), max_size=30), indent=st.integers(0, 6)
)
def test_a_wrapped_line_has_the_same_words_and_fits(words: list[str], indent: int) -> None:
    lines = wrapped(" " * indent + " ".join(words), 20).split("\n")
    assert " ".join(lines).split() == words and all(len(line) <= 20 for line in lines)
    assert all(line.startswith(" " * (indent + 2)) for line in lines[1:])


@pytest.mark.parametrize("colour", [True, False])
def test_a_console_styles_its_own_words_alone(colour: bool) -> None:
    written = StringIO()
    table = Table("log")
    table.add_row(Text(EVIL, style="red"))
    console = SafeConsole(
        file=written, width=100, force_terminal=colour, color_system="standard" if colour else None
    )
    console.print(table, EVIL)
    shown = written.getvalue()
    assert ("\x1b[31m" in shown) == colour
    assert not any(raw in shown for raw in RAW)
    assert "\u241b[2J" in shown


def test_no_command_prints_control_characters_of_names(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", replace(short("x"), name=EVIL))
    evaluate = [
        "evaluate",
        str(tmp_path / "log.mcap"),
        "-p",
        "constant_speed",
        "--workers",
        "0",
        "--no-recording",
    ]
    for words in (
        ["inspect", str(tmp_path / "log.mcap")],
        ["inspect", str(tmp_path / EVIL.replace("/", ""))],
        [*evaluate, "-v", "-o", str(tmp_path / "out")],
        ["compare", str(tmp_path / "out"), str(tmp_path / "out")],
    ):
        done = CliRunner().invoke(app, words, color=True)
        assert not any(raw in done.output for raw in RAW)


@pytest.mark.slow
def test_a_letter_that_the_encoding_lacks_is_replaced(tmp_path: Path) -> None:
    write_scenario(tmp_path / "北.mcap", short("x"))
    path = os.pathsep.join(sys.path)
    environment = {
        **os.environ,
        "PYTHONIOENCODING": "latin-1",
        "PYTHONPATH": path,
        "PYTHONUTF8": "1",
    }
    command = [sys.executable, "-c", "from replan.cli import main; main()", "inspect", "北.mcap"]
    for more, said in (([], b"?.mcap"), (["--json"], b"\\u5317.mcap")):
        done = subprocess.run(
            [*command, *more], env=environment, cwd=tmp_path, capture_output=True, check=False
        )
        assert done.returncode == 0 and b"Traceback" not in done.stderr
        assert said in done.stdout
