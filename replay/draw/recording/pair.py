"""Two drives of one log in one window: both scenes and graphs, their curves together, and their first difference.

The chunks of both recordings go under `A` and `B`; the curves of the difference (B minus A while both drive) and the
page about the first difference (`replay.explain.first_difference`) are added.

(1) gap   = sqrt((x_B - x_A)^2 + (y_B - y_A)^2)      between the reference points, m
(2) v, a  = v_B - v_A, a_B - a_A                     m/s, m/s2
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from math import nan
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from logs.arrays import FloatArray
from logs.errors import ConfigError
from logs.trace import Trace
from replay.draw.model import SERIES, SL, ST, Curve, Panel
from replay.draw.recording.blueprint import graph_view, lanes_beside_numbers, scene_behind, state_view, window
from replay.draw.recording.plots import LANES, plot
from replay.draw.recording.tape import MARKDOWN, Instants, cell, document, recording_file
from replay.explain.first_difference import first_difference

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


def write_pair(path: Path, recordings: tuple[Path, Path], traces: tuple[Trace, Trace], names: tuple[str, str]) -> None:
    """Write two recordings as one.

    Raises:
        ConfigError: The drives are of different logs.
        OutputError: The file cannot be written.
    """
    one, two = traces
    if one.scenario != two.scenario:
        raise ConfigError(f"both drives must be of the same log, not of {one.scenario} and {two.scenario}")
    chunks = [
        [
            chunk.with_entity_path(f"/{side}{chunk.entity_path}")
            for chunk in RrdReader(str(file)).stream().to_chunks()
            if not chunk.entity_path.startswith("/__properties")
        ]
        for side, file in zip(SIDES, recordings, strict=True)
    ]
    t, values = difference(one, two)
    paths = {chunk.entity_path for some in chunks for chunk in some}
    digest = sha256("".join([*map(str, recordings), *names]).encode()).hexdigest()[:32]
    layout = _blueprint(paths, names, traces, t, values)
    with recording_file(path, f"replan pair {one.scenario}", " and ".join(names), digest, layout) as tape:
        for some in chunks:
            tape.stream.send_chunks(some)
        frames = np.array([frame.t for frame in one.frames]) if one.frames else t
        instants = Instants.among(t, frames)
        for (name, legend), colour in zip(LEGENDS.items(), SERIES, strict=False):
            tape.static(f"difference/{name}", rr.SeriesLines(colors=[colour], names=[legend], widths=[1.5]))
            tape.rows(f"difference/{name}", instants, rr.Scalars.columns(scalars=values[name]))
        where = first_difference(one, two)
        words = [f"- **{side}**: {cell(name)}" for side, name in zip(SIDES, names, strict=True)]
        words += ["", f"**First difference: {cell(where.what)}**" if where else "The drives do not differ."]
        far = np.flatnonzero(values["gap"] > APART_M)
        sentence = f"The egos are never more than {APART_M:g} m apart."
        if len(far):
            first, most = t[far[0]], np.nanmax(values["gap"])
            sentence = f"The egos are more than {APART_M:g} m apart from t = {first:.2f} s on, at most {most:.1f} m."
        words += ["", sentence]
        tape.static("parting", rr.TextDocument(document(words), media_type=MARKDOWN))
        if where is not None:  # a mark on the curves of the difference
            style = rr.SeriesPoints(colors=[MARK], markers=["Diamond"], marker_sizes=[7.0], names=["first difference"])
            tape.static("parts", style)
            tape.rows("parts", Instants.among(np.array([where.t]), frames), rr.Scalars.columns(scalars=[0.0]))


def difference(one: Trace, two: Trace) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Times `(n,)` of the longer drive and differences `(n,)` by name, NaN after the end of the other: (1), (2)."""
    a, b = one.ego, two.ego
    t = a.t if a.t[-1] >= b.t[-1] else b.t
    first, second = (
        {name: np.interp(t, ego.t, getattr(ego, name), nan, nan) for name in ("x", "y", "v", "a")} for ego in (a, b)
    )
    apart = {name: second[name] - first[name] for name in first}
    return t, {"gap": np.hypot(apart["x"], apart["y"]), "v": apart["v"], "a": apart["a"]}


def _blueprint(
    paths: set[str], names: tuple[str, str], traces: tuple[Trace, Trace], t: FloatArray, values: dict[str, FloatArray]
) -> rrb.Blueprint:
    """Scenes and graphs of both side by side on the left, words and curves on the right."""
    scenes = [scene_behind(f"{side}: {name}", f"/{side}") for side, name in zip(SIDES, names, strict=True)]
    graphs = [  # a tab for each kind of graph that both have
        rrb.Horizontal(
            *(graph_view(f"{side}: {kind.title}", f"/{side}/graphs", f"/{side}/graphs/{kind.name}") for side in SIDES),
            name=kind.title,
        )
        for kind in (ST, SL)
        if all(any(path.startswith(f"/{side}/graphs/{kind.name}") for path in paths) for side in SIDES)
    ]
    left: list[rrb.Container | rrb.View] = [rrb.Horizontal(*scenes), *_tabs(graphs)]
    pages = [rrb.TextDocumentView(origin=f"/{side}/why", name=f"{side}: why") for side in SIDES]
    words = rrb.Tabs(rrb.TextDocumentView(origin="/parting", name="First difference"), *pages, active_tab=0)
    states = [
        state_view(f"{side}: decisions and status", lanes, f"/{side}")
        for side in SIDES
        if (lanes := [lane for lane in LANES if f"/{side}/{lane}" in paths])
    ]
    curves, apart = list[rrb.View](), list[rrb.View]()
    for name, title, column, least in CURVES:  # curves of both egos, which are in the recordings already
        egos = tuple(
            Curve(side, side, trace.ego.t, getattr(trace.ego, column))
            for side, trace in zip(SIDES, traces, strict=True)
        )
        there = {
            path: rr.SeriesLines(names=[side], colors=[shade])
            for side, shade in zip(SIDES, SHADES, strict=True)
            if (path := f"/{side}/plots/{name}/ego") in paths
        }
        curves.append(plot(Panel(name, title, egos, least), origin="/", contents=list(there), overrides=there))
    for title, shown in DIFFERENCES:
        panel = Panel("difference", title, tuple(Curve(one, LEGENDS[one], t, values[one]) for one in shown), 1.0)
        apart.append(plot(panel, origin="/", contents=[*(f"/difference/{one}" for one in shown), "/parts"]))
    right = [words, *_tabs(curves), *_tabs(apart), *(lanes_beside_numbers(part, "/A") for part in _tabs(states))]
    columns = (
        rrb.Vertical(*left, row_shares=[1.35, 1.0][: len(left)]),
        rrb.Vertical(*right, row_shares=[0.9, 1.3, 1.3, 1.3][: len(right)]),
    )
    return window(rrb.Horizontal(*columns, column_shares=[1.75, 1.0], name="Pair"))


def _tabs(views: Sequence[rrb.Container | rrb.View]) -> list[rrb.Container]:
    return [rrb.Tabs(*views, active_tab=0)] if views else []
