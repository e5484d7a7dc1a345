"""What a decision to yield or to go first says: by how much it stays clear, and what both orders cost."""

import re

import numpy as np
import pytest

from logs.catalogue import scenario
from logs.plan import Decision, DecisionKind, StGraph
from replay.loop.closed_loop import run_closed_loop

SAID = re.compile(r"(?:keeps (-?[\d.]+) m, )?(yielding|going first) (.+?), (yielding|going first) (.+)$")
WORDS = {DecisionKind.YIELD: "yielding", DecisionKind.OVERTAKE: "going first"}


def price(words: str) -> float:
    return float("inf") if words == "would collide" else float(words.removeprefix("costs "))


@pytest.mark.parametrize("name", ["everyday/junction", "paper/crossing_pedestrian"])
def test_the_order_that_is_taken_costs_least_and_the_solution_keeps_what_is_said(name: str) -> None:
    drive = run_closed_loop(scenario(name), "dp_qp", keep_internals=True)
    counts = dict.fromkeys(WORDS, 0)
    for frame in drive.trace.frames:
        graphs = [item for item in frame.plan.internals if isinstance(item, StGraph)]
        for item in frame.plan.internals:
            if not isinstance(item, Decision) or (found := SAID.search(item.reason)) is None:
                continue
            keeps, first, cost, second, other = found.groups()
            assert WORDS[item.kind] == first != second
            counts[item.kind] += 1
            if "cannot be there first" not in item.reason:
                assert price(cost) <= price(other) + 0.1, f"{frame.t:.1f} s: {item.reason}"
            outlines = [thing.outline for graph in graphs for thing in graph.obstacles if thing.agent == item.agent]
            if keeps is not None and len(outlines) == 1:
                assert clear(graphs[0].qp, outlines[0], item.kind) == pytest.approx(float(keeps), abs=0.06)
    assert counts[DecisionKind.YIELD] > 5, counts


def clear(qp: np.ndarray, outline: np.ndarray, kind: DecisionKind) -> float:
    """By how much the solution is behind (or ahead of) the lower (upper) half of an outline, m."""
    low, high = outline[: len(outline) // 2], outline[len(outline) // 2 :]
    side = low if kind is DecisionKind.YIELD else high
    s = np.interp(side[:, 0], *qp.T)
    return float((side[:, 1] - s).min() if kind is DecisionKind.YIELD else (s - side[:, 1]).min())
