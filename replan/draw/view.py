"""Open recordings in the Rerun viewer: a recording, a log, or all recordings of a result folder,
with an index.

The index lists the drives, the worst first as in the reports (`Overview.ranked`), each with a link
that opens its recording.

Two drives of one log share a window: both scenes and graphs, their curves together, and their first
difference. The chunks of both recordings go under `A` and `B`; the curves of the difference (B
minus A while both drive) and the page about the first difference
(`replan.explain.first_difference`) are added.

(1) gap   = sqrt((x_B - x_A)^2 + (y_B - y_A)^2)      between the reference points, m
(2) v, a  = v_B - v_A, a_B - a_A                     m/s, m/s2
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from hashlib import sha256
from math import nan
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, ReplanError
from replan.core.names import counted
from replan.draw.drawn_results import load
from replan.draw.markers import Marker
from replan.draw.panels import SERIES, Curve, Panel
from replan.draw.plan_graphs import SL, ST
from replan.draw.recording import write_log_recording
from replan.draw.recording.pictures import (
    LOOPBACK,
    Picture,
    Theme,
    environment,
    free_port,
    in_use,
    take_pictures,
)
from replan.draw.recording.plots import (
    graph_view,
    lanes_beside_numbers,
    plot,
    scene_behind,
    state_view,
    window,
)
from replan.draw.recording.state_rows import LANES
from replan.draw.recording.tape import (
    MARKDOWN,
    Instants,
    cell,
    document,
    link,
    recording_file,
    table,
)
from replan.draw.report.overview import overview
from replan.explain.first_difference import first_difference
from replan.logs.mcap import read_trace
from replan.logs.readers import LogSettings, read_log
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.results.load import named_logs

ELSEWHERE = (
    "copy the .rrd to a machine with one and open it there with `rerun FILE.rrd`, or add "
    "--web to see it in a browser"
)
MOST = 12  # Recordings opened at once: each takes memory in the viewer; the index has links to all


def write_index(path: Path, folder: Path, most: int) -> list[Path]:
    """Write the index of a folder; returns the recordings of the worst drives, at most `most`, the
    worst last.

    The viewer shows the recording that was opened last, and lists recordings by name.
    ConfigError if the folder is not a result folder; OutputError if the file cannot be written.
    """
    over = overview(load(folder))
    rows = over.drives
    opened = [row for row in rows if row.recording][:most]
    lines = [f"# {cell(over.outcome)}: {counted(len(rows), 'drive')}, worst first", ""]
    recorded = sum(bool(row.recording) for row in rows)
    click = " A click on the name of a log opens its recording." if recorded else ""
    beside = (
        f"Open beside this page: {len(opened)} of {counted(recorded, 'recording')}, those of the "
        "worst drives."
    )
    lines.append(beside + click)
    if recorded > len(opened):
        lines += [
            "",
            f"Both loops of one: `replan view {document([shlex.quote(str(folder))])} --log LOG`.",
        ]
    if recorded < len(rows):
        lines += ["", f"Without recording: {counted(len(rows) - recorded, 'drive')}."]
    names = [column.title.replace("\n", " ") for column in over.columns]
    body = []
    for row in rows:
        name = link(row.log, (folder / row.recording).resolve()) if row.recording else row.log
        body.append(
            (
                name,
                row.shown,
                row.verdict or "not judged",
                row.end.text,
                *(column.cell(row).text for column in over.columns),
            )
        )
    lines += table(("log", "planner", "gates", "end", *names), body)
    digest = sha256("".join(lines).encode()).hexdigest()[:32]
    view = rrb.TextDocumentView(origin="/index", name="Index")
    layout = rrb.Blueprint(
        view,
        rrb.BlueprintPanel(state="expanded"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="hidden"),
    )
    with recording_file(path, "replan index", "index", digest, layout) as tape:
        tape.static("index", rr.TextDocument(document(lines), media_type=MARKDOWN))
    return [folder / row.recording for row in opened[::-1]]


def recordings(target: Path, log: str | None = None) -> list[Path]:
    """The recordings of a folder, sorted by path.

    `log`: name of a log or its folder: only recordings whose path contains it. ConfigError if there
    are no such recordings.
    """
    files = sorted(target.rglob("*.rrd"))
    if not files:
        raise ConfigError(
            f"{target}: no recording (*.rrd) in it; `replan evaluate` without --no-recording "
            "writes them"
        )
    named = {file.relative_to(target).as_posix(): file for file in files}
    return files if log is None else [named[name] for name in named_logs(log, named)]


def to_open(target: Path, files: list[Path], folder: Path, *, index: bool) -> list[Path]:
    """The files to open: the recordings of a folder, at most `MOST`, or the index and those of the
    worst drives.

    `target`: a folder of results, or any folder with recordings. `index`: whether to write and open
    the index of a result folder. ConfigError if there are too many.
    """
    if index:
        page = folder / "index.rrd"
        return [*write_index(page, target, MOST), page]
    if len(files) > MOST:
        raise ConfigError(
            f"{target}: {len(files)} recordings are too many to open at once (at most {MOST});"
            f" name fewer with --log, --planner, --mode, or a recording, for example {files[0]}"
        )
    return files


def choose_pair(one: Path, two: Path, found: list[Path], others: list[Path]) -> tuple[Path, Path]:
    """The recordings of two drives: two files, or those in `found` and `others` at the same place
    in two folders.

    ConfigError if there is no such pair, or there are several.
    """
    if one.is_file() and two.is_file():
        return one, two
    if one.is_file() or two.is_file():
        raise ConfigError("name two recordings, or two folders of results")
    first = {file.relative_to(one): file for file in found}
    second = {file.relative_to(two): file for file in others}
    both = sorted(first.keys() & second.keys())
    if not both:
        raise ConfigError(f"{one} and {two} have no recording in common")
    if len(both) > 1:
        files = ", ".join(str(file) for file in both[:4])
        raise ConfigError(
            f"{len(both)} recordings are in both ({files} ...): name a drive with --log, --planner "
            "and --mode"
        )
    return first[both[0]], second[both[0]]


def save_pair(out: Path, files: tuple[Path, Path]) -> None:
    """Write two recordings of one log as one; ConfigError if their traces are not beside them."""
    for file in files:
        if not file.with_suffix(".mcap").is_file():
            raise ConfigError(
                f"{file}: its trace ({file.with_suffix('.mcap').name}) is not beside it"
            )
    first, second = (read_trace(file.with_suffix(".mcap"))[0] for file in files)
    names = [f"{trace.planner}, {trace.mode.value} loop" for trace in (first, second)]
    if names[0] == names[1]:
        names = [
            f"{name} ({file.parent.parent.name})" for name, file in zip(names, files, strict=True)
        ]
    write_pair(out, files, (first, second), (names[0], names[1]))


def save_log(
    log: Path,
    out: Path,
    settings: LogSettings | None,
    markers: Callable[[Scenario], Sequence[Marker]],
) -> None:
    """Write a log of any format as a recording, with its markers.

    LogError if the log cannot be read; OutputError if the recording cannot be written.
    """
    scenario = read_log(log, settings)
    write_log_recording(out, scenario, markers(scenario))


def show(files: list[Path], memory_limit: str, *, web: bool = False, port: int = 9090) -> None:
    """Run the viewer on recordings until it is closed; it listens on this machine only.

    `memory_limit`: memory of the viewer ("2GB", "50%"). `port`: port of the page, with `web`.
    ConfigError if the port is in use; ReplanError if there is no display, or the viewer ended with
    an error (no graphics driver).
    """
    if (
        not web
        and sys.platform == "linux"
        and not {"DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"} & {*os.environ}
    ):
        raise ReplanError(
            f"there is no display here (DISPLAY and WAYLAND_DISPLAY are not set); {ELSEWHERE}"
        )
    if web and in_use(port):
        raise ConfigError(
            f"port {port} is in use; close what uses it (another viewer?), or name another with "
            "--port"
        )
    command = [sys.executable, "-m", "rerun", "--bind", LOOPBACK, "--port", str(free_port())]
    command += ["--memory-limit", memory_limit]
    command += ["--web-viewer", "--web-viewer-port", str(port)] if web else []
    with environment() as variables:
        code = subprocess.run([*command, *map(str, files)], env=variables, check=False).returncode
    if code:
        raise ReplanError(
            "the viewer ended with an error (above); without a display or graphics driver, "
            f"{ELSEWHERE}"
        )


def picture(
    recording: Path, out: Path, at: float, layout: str, tile: str | None, size: str, theme: Theme
) -> None:
    """A picture of a recording at a time, s; ConfigError if it has no such layout or tile."""
    take_pictures(recording, [Picture(out, at, tile, layout)], size=size, theme=theme)


SIDES = ("A", "B")
SHADES = (0x5AC8FFFF, 0xFF963CFF)
CURVES = (("speed", "Speed [m/s]", "v", 2.0), ("acceleration", "Acceleration [m/s²]", "a", 1.0))
"""Panel, title, column of the trace, least span of the axis."""
LEGENDS = {"gap": "distance", "v": "speed [m/s]", "a": "acceleration [m/s²]"}
DIFFERENCES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("Distance between them [m]", ("gap",)),
    ("B minus A", ("v", "a")),
)
APART_M = 0.5  # Drives that are farther apart than this look different
MARK = 0xFF463CFF


def write_pair(
    path: Path, recordings: tuple[Path, Path], traces: tuple[Trace, Trace], names: tuple[str, str]
) -> None:
    """Write two recordings as one.

    ConfigError if the drives are of different logs; OutputError if the file cannot be written.
    """
    one, two = traces
    if one.scenario != two.scenario:
        raise ConfigError(
            f"both drives must be of the same log, not of {one.scenario} and {two.scenario}"
        )
    chunks = [
        [
            chunk.with_entity_path(f"/{side}{chunk.entity_path}")
            for chunk in RrdReader(str(file)).stream().to_chunks()
            if not chunk.entity_path.startswith("/__properties")
        ]
        for side, file in zip(SIDES, recordings, strict=True)
    ]
    t, values = difference(one, two)
    paths = {chunk.entity_path for of_side in chunks for chunk in of_side}
    digest = sha256("".join([*map(str, recordings), *names]).encode()).hexdigest()[:32]
    layout = _blueprint(paths, names, traces, t, values)
    with recording_file(
        path, f"replan pair {one.scenario}", " and ".join(names), digest, layout
    ) as tape:
        for of_side in chunks:
            tape.stream.send_chunks(of_side)
        frames = np.array([frame.t for frame in one.frames]) if one.frames else t
        instants = Instants.among(t, frames)
        for (name, legend), colour in zip(LEGENDS.items(), SERIES, strict=False):
            tape.static(
                f"difference/{name}", rr.SeriesLines(colors=[colour], names=[legend], widths=[1.5])
            )
            tape.rows(f"difference/{name}", instants, rr.Scalars.columns(scalars=values[name]))
        where = first_difference(one, two)
        words = [f"- **{side}**: {cell(name)}" for side, name in zip(SIDES, names, strict=True)]
        words += [
            "",
            f"**First difference: {cell(where.what)}**" if where else "The drives do not differ.",
        ]
        far = np.flatnonzero(values["gap"] > APART_M)
        sentence = f"The egos are never more than {APART_M:g} m apart."
        if len(far):
            first, most = t[far[0]], np.nanmax(values["gap"])
            sentence = (
                f"The egos are more than {APART_M:g} m apart from t = {first:.2f} s on, at "
                f"most {most:.1f} m."
            )
        words += ["", sentence]
        tape.static("parting", rr.TextDocument(document(words), media_type=MARKDOWN))
        if where is not None:  # a mark on the curves of the difference
            style = rr.SeriesPoints(
                colors=[MARK], markers=["Diamond"], marker_sizes=[7.0], names=["first difference"]
            )
            tape.static("parts", style)
            tape.rows(
                "parts",
                Instants.among(np.array([where.t]), frames),
                rr.Scalars.columns(scalars=[0.0]),
            )


def difference(one: Trace, two: Trace) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Times `(n,)` of the longer drive and differences `(n,)` by name, NaN after the end of the
    other: (1), (2).
    """
    a, b = one.ego, two.ego
    t = a.t if a.t[-1] >= b.t[-1] else b.t
    first, second = (
        {name: np.interp(t, ego.t, getattr(ego, name), nan, nan) for name in ("x", "y", "v", "a")}
        for ego in (a, b)
    )
    differences = {name: second[name] - first[name] for name in first}
    return t, {
        "gap": np.hypot(differences["x"], differences["y"]),
        "v": differences["v"],
        "a": differences["a"],
    }


def _blueprint(
    paths: set[str],
    names: tuple[str, str],
    traces: tuple[Trace, Trace],
    t: FloatArray,
    values: dict[str, FloatArray],
) -> rrb.Blueprint:
    """Scenes and graphs of both side by side on the left, words and curves on the right."""
    scenes = [
        scene_behind(f"{side}: {name}", f"/{side}") for side, name in zip(SIDES, names, strict=True)
    ]
    graphs = [  # a tab for each kind of graph that both have
        rrb.Horizontal(
            *(
                graph_view(
                    f"{side}: {kind.title}", f"/{side}/graphs", f"/{side}/graphs/{kind.name}"
                )
                for side in SIDES
            ),
            name=kind.title,
        )
        for kind in (ST, SL)
        if all(
            any(path.startswith(f"/{side}/graphs/{kind.name}") for path in paths) for side in SIDES
        )
    ]
    left: list[rrb.Container | rrb.View] = [rrb.Horizontal(*scenes), *_tabs(graphs)]
    pages = [rrb.TextDocumentView(origin=f"/{side}/why", name=f"{side}: why") for side in SIDES]
    words = rrb.Tabs(
        rrb.TextDocumentView(origin="/parting", name="First difference"), *pages, active_tab=0
    )
    states = [
        state_view(f"{side}: decisions and status", lanes, f"/{side}")
        for side in SIDES
        if (lanes := [lane for lane in LANES if f"/{side}/{lane}" in paths])
    ]
    curves, differences = list[rrb.View](), list[rrb.View]()
    # Curves of both egos, which are in the recordings already
    for name, title, column, least in CURVES:
        egos = tuple(
            Curve(side, side, trace.ego.t, getattr(trace.ego, column))
            for side, trace in zip(SIDES, traces, strict=True)
        )
        present = {
            path: rr.SeriesLines(names=[side], colors=[shade])
            for side, shade in zip(SIDES, SHADES, strict=True)
            if (path := f"/{side}/plots/{name}/ego") in paths
        }
        curves.append(
            plot(
                Panel(name, title, egos, least),
                origin="/",
                contents=list(present),
                overrides=present,
            )
        )
    for title, shown in DIFFERENCES:
        panel = Panel(
            "difference",
            title,
            tuple(Curve(name, LEGENDS[name], t, values[name]) for name in shown),
            1.0,
        )
        differences.append(
            plot(panel, origin="/", contents=[*(f"/difference/{name}" for name in shown), "/parts"])
        )
    right = [
        words,
        *_tabs(curves),
        *_tabs(differences),
        *(lanes_beside_numbers(part, "/A") for part in _tabs(states)),
    ]
    columns = (
        rrb.Vertical(*left, row_shares=[1.35, 1.0][: len(left)]),
        rrb.Vertical(*right, row_shares=[0.9, 1.3, 1.3, 1.3][: len(right)]),
    )
    return window(rrb.Horizontal(*columns, column_shares=[1.75, 1.0], name="Pair"))


def _tabs(views: Sequence[rrb.Container | rrb.View]) -> list[rrb.Container]:
    return [rrb.Tabs(*views, active_tab=0)] if views else []
