"""The HTML report: one file that asks for nothing, whatever logs are called.

Every drive is in it.
"""

import re
from dataclasses import replace
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path

import pytest
from handmade import drive, lanes_along, scenario, square, straight, track, tracks

from replan.compare_runs import compare_runs, read_run
from replan.config import RunConfig
from replan.core.names import visible_name
from replan.draw.charts import subject, worst_moment
from replan.draw.charts.layout import CHARTS
from replan.draw.drawn_results import Results, load
from replan.draw.report.html import write_html
from replan.draw.report.overview import overview
from replan.draw.report.write import write_reports
from replan.logs.mcap import write_scenario
from replan.logs.road import Goal
from replan.run import evaluate_logs

HOSTILE = "x</script><script>alert(1)</script>\" onload='y'\n<b>&amp;{{ 7 * 7 }}"
MOST_BYTES_A_DRIVE = 50_000


class Page(HTMLParser):
    """What an independent parser finds in the page."""

    def __init__(self, content: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.feed(content)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    def all(self, attribute: str) -> list[str]:
        return [attrs[attribute] or "" for _, attrs in self.tags if attribute in attrs]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Three logs of not quite three seconds, two planners, one log with a name and an agent that
    are no friends.
    """
    folder = tmp_path_factory.mktemp("logs")
    ego = drive(straight, 8.0, 2.9)
    free = scenario(ego, road=lanes_along(ego), goal=Goal((square(27.0, 0.0, 4.0),)))
    wall = tracks(track("<img src=x onerror=alert(2)>", [0.0], [24.0], [0.0], static=True))
    write_scenario(folder / "free.mcap", replace(free, name="test/free"))
    write_scenario(folder / "same.mcap", replace(free, name="test free"))
    write_scenario(
        folder / "hostile.mcap", replace(free, name=HOSTILE, tracks=wall, tags=("<i>tag",))
    )
    config = RunConfig(planners=("dp_qp", "constant_speed"), recording=False)
    return evaluate_logs([folder], config, tmp_path_factory.mktemp("results") / "run")


@pytest.fixture(scope="module")
def content(results: Results, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "report.html"
    runs = read_run(results.path)
    compared = compare_runs(runs, runs, planners=("constant_speed", "dp_qp"))
    write_html(overview(results, compared), path)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(content: str) -> Page:
    return Page(content)


def test_the_page_makes_no_request(page: Page, content: str) -> None:
    assert not {"img", "link", "iframe", "object", "embed", "base", "form", "audio", "video"} & {
        t for t, _ in page.tags
    }
    assert not page.all("src") and not page.all("action") and not page.all("xlink:href")
    assert not [href for href in page.all("href") if re.match(r"[a-z]+:|//|/", href)]
    assert not re.search(r"https?://|@import|url\(|fetch\(|XMLHttpRequest|WebSocket", content)
    policy = next(
        attrs["content"]
        for _, attrs in page.tags
        if attrs.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy is not None and policy.startswith("default-src 'none'")


def test_hostile_names_are_escaped_in_html(page: Page, content: str) -> None:
    assert content.count("<script>") == content.count("</script>") == 1
    assert not [name for _, attrs in page.tags for name in attrs if name.startswith("on")]
    assert {tag for tag, _ in page.tags} & {"b", "i", "img"} <= {"b"}  # <b> are the times of events
    text = " ".join(page.text)
    assert (
        "{{ 7 * 7 }}" in text
        and "<img src=x onerror=alert(2)>" in text
        and "<i>tag" in text
        and "49" not in HOSTILE
    )


def test_every_drive_is_linked_and_every_link_has_its_target(page: Page, results: Results) -> None:
    ids = page.all("id")
    assert len(set(ids)) == len(ids)
    inside = [href[1:] for href in page.all("href") if href.startswith("#")]
    assert set(inside) <= set(ids)
    drives = [one for one in ids if one.startswith("drive/")]
    assert len(drives) == 6 and set(drives) <= set(inside)
    # In the table, from its neighbours, and in a comparison
    assert inside.count("drive/test_free/dp_qp") > 3
    assert "drive/test_free/dp_qp" in drives and "drive/test_free/dp_qp-2" in drives


def test_the_page_is_readable_without_script_and_labelled(page: Page) -> None:
    hidden = [(tag, attrs) for tag, attrs in page.tags if "hidden" in attrs]
    assert [attrs["class"] for _, attrs in hidden] == ["filter"]  # useless without script
    labels = {attrs["for"] for tag, attrs in page.tags if tag == "label"}
    assert {attrs["id"] for tag, attrs in page.tags if tag == "input"} == labels == {"filter"}
    assert next(attrs for tag, attrs in page.tags if tag == "a")["class"] == "skip"
    charts = [attrs for tag, attrs in page.tags if tag == "svg" and attrs.get("class") == "chart"]
    assert len(charts) > 60 and all(
        attrs["role"] == "img" and attrs["aria-label"] for attrs in charts
    )
    heads = [attrs.get("scope") for tag, attrs in page.tags if tag == "th"]
    assert set(heads) == {"row", "col"}


def test_the_page_contains_gates_moments_and_reasons_of_the_run(
    page: Page, results: Results
) -> None:
    text = " ".join(" ".join(page.text).split())
    over = overview(results)
    for said in (
        *(row.rule for row in over.gates),
        *(row.finding for row in over.gates if not row.log),
        over.config,
    ):
        assert said in text
    assert "Flips: " in text and "Worst regressions" in text
    assert re.search(r"replan view \S*closed.constant_speed.mcap", text)
    moment = worst_moment(results.drive(visible_name(HOSTILE), "constant_speed"))
    assert moment.why.startswith("collision_at_fault.count <= 0 [closed] fails: 1")
    assert f"Look at {moment.t:.2f} s : {moment.why.split('<img')[0]}" in text
    # The loop in which a gate fails
    because = subject(results.drive(visible_name(HOSTILE), "dp_qp", "open")).because
    assert because[0].startswith("The plan at t = ") and because[0] in text


@pytest.mark.slow
def test_the_same_run_gives_the_same_bytes_in_any_folder(results: Results, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_html(overview(load(results.path)), tmp_path / name / "report.html")
    first, second = ((tmp_path / name / "report.html").read_bytes() for name in ("a", "b"))
    assert first == second and str(tmp_path.parent.parent).encode() not in first
    beside = results.path / "report.html"
    write_html(overview(results), beside)
    assert (
        b'href="test_free-' in beside.read_bytes() and b"replan plot . --log" in beside.read_bytes()
    )


def test_a_drive_costs_less_than_fifty_kilobytes(results: Results, tmp_path: Path) -> None:
    over, sizes = overview(results), []
    for drives in (1, 6):
        write_html(over, tmp_path / "report.html", drives=drives)
        sizes.append((tmp_path / "report.html").stat().st_size)
        said = "The worst 1 of 6 have a page" in (tmp_path / "report.html").read_text(
            encoding="utf-8"
        )
        assert said is (drives == 1)
    assert (sizes[1] - sizes[0]) / 5 < MOST_BYTES_A_DRIVE


def test_a_damaged_trace_removes_only_its_pictures(results: Results, tmp_path: Path) -> None:
    trace = results.drive("test/free", "dp_qp").trace_file
    whole = trace.read_bytes()
    try:
        trace.write_bytes(whole[: len(whole) // 2])
        write_html(overview(load(results.path)), tmp_path / "report.html")
    finally:
        trace.write_bytes(whole)
    assert "no pictures: the file is cut off or damaged" in (tmp_path / "report.html").read_text(
        encoding="utf-8"
    )


def test_an_error_in_a_part_of_a_report_removes_only_that_part(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A chart, an account, a page: each may raise.

    The page says what failed, the other reports and verdicts stay.
    """

    def fails(*args: object, **keywords: object) -> object:
        raise MemoryError("Unable to allocate 99.3 GiB")

    before = overview(results)
    assert not write_reports(before, tmp_path / "whole").broken
    for place, said in (
        (
            "replan.draw.charts.subject.accounts",
            "The account of the plan could not be made: MemoryError: Unable",
        ),
        ("replan.draw.report.drive_page.subject", "no pictures: the memory is used up"),
        (
            "replan.draw.report.html.drive_page",
            "The page of a drive could not be made: MemoryError",
        ),
        ("replan.draw.report.html.pass_shares", "The chart of shares could not be made"),
    ):
        with monkeypatch.context() as patch:
            module, _, name = place.rpartition(".")
            patch.setattr(import_module(module), name, fails)
            over = write_reports(before, tmp_path / "run")
        assert said in (tmp_path / "run" / "report.html").read_text(encoding="utf-8") + " ".join(
            over.broken
        )
        assert (over.exit_code, over.outcome) == (before.exit_code, before.outcome)
    runs = read_run(results.path)
    compared = overview(results, compare_runs(runs, runs, planners=("constant_speed", "dp_qp")))
    for part, words in (
        ("run_sections", "The tables of the run could not be made"),
        ("comparison_sections", "The comparison could not be made"),
        ("most_moved", "The charts of changes could not be made"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(f"replan.draw.report.html.{part}", fails)
            broken = write_html(compared, tmp_path / "report.html")
        assert broken[0].startswith(words)
        assert words in (tmp_path / "report.html").read_text(encoding="utf-8")
    monkeypatch.setitem(CHARTS, "curves", fails)
    over = write_reports(before, tmp_path / "run")
    assert any("The chart curves could not be drawn: MemoryError" in line for line in over.broken)
    monkeypatch.setattr("replan.draw.report.write.write_html", fails)
    over = write_reports(before, tmp_path / "none")
    assert over.broken[0].startswith("report.html could not be made: MemoryError")
    assert "report.html could not be made" in (tmp_path / "none" / "report.md").read_text(
        encoding="utf-8"
    )
