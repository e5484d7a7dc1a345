"""What a plan of PDM-Closed shows: both graphs of the chosen proposal, its leaders, and the score
terms of all.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.plan import Artefact, Candidates, Corridor, CostTerms, SlGraph, StGraph
from replan.planners.frenet.path import Path
from replan.planners.frenet.profiles import HORIZON_KNOTS, STEP_S
from replan.planners.frenet.scene import Occupancy, Scene
from replan.planners.frenet.st_boundaries import StBoundaries, decide_speed, outlines, stop_outlines
from replan.planners.pdm.proposal_score import FACTORS, TERMS, Scores

EVERY = 8
"""Knots of the track per point of the S-L graph."""
WORSE_BY = 1e-9
"""Parts of the score that differ by less are equal: they are rounded."""


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """A path along the route at an offset, agents and stops on it, drivers' profiles s, v
    `(n, 2, HORIZON_KNOTS)`.
    """

    offset: float
    path: Path
    blocks: StBoundaries
    stops: tuple[Occupancy, ...]
    profiles: FloatArray


def make_artefacts(
    scene: Scene, track: Track, profile: FloatArray, names: list[str], scored: Scores, chosen: int
) -> tuple[Artefact, ...]:
    """Both graphs of the chosen proposal, decisions, the score terms of all, why others were not
    chosen.

    The chosen proposal drives its `profile` s, v `(2, HORIZON_KNOTS)` along the `track`; the
    `names` are those of all proposals, in the order of the scores.
    """
    t, driven_m = STEP_S * np.arange(HORIZON_KNOTS), profile[0]
    decisions = decide_speed(track.blocks, scene, np.interp(track.blocks.t, t, driven_m))
    drawn = (
        *outlines(track.blocks, decisions),
        *stop_outlines(track.stops, float(t[-1]), track.path.length),
    )
    decided = {decision.agent: decision for decision in decisions}.values()
    return (
        StGraph(None, None, np.empty((0, 2)), np.column_stack([t, driven_m]), drawn),
        _sl_graph(scene, track),
        *decided,
        *(stop.decision for stop in track.stops),
        *_costs(names, scored, chosen),
    )


def _sl_graph(scene: Scene, track: Track) -> SlGraph:
    s, side, reference = track.path.s[::EVERY], 0.5 * scene.vehicle.width, scene.reference
    edges = (reference.facing_right, reference.facing_left)
    right, left = (np.interp(s, reference.line.s, edge) for edge in edges if edge is not None)
    line = np.column_stack([s, np.full(len(s), track.offset)])
    return SlGraph(None, Corridor(s, right + side, left - side), np.empty((0, 2)), line, ())


def _costs(names: list[str], scored: Scores, chosen: int) -> list[CostTerms | Candidates]:
    """The terms of all proposals, the chosen one first, and how many are worse in what part."""
    rows = [chosen, *(n for n in range(len(names)) if n != chosen)]
    costs: list[CostTerms | Candidates] = []
    for n in rows:
        weighted = zip(TERMS, scored.weighted[:, n].tolist(), strict=True)
        terms = tuple((term.name, value) for term, value in weighted)
        costs.append(CostTerms("taken: " * (n == chosen) + names[n], terms))
    parts = FACTORS + TERMS
    worse = (scored.parts < scored.parts[:, chosen, None] - WORSE_BY)[:, rows[1:]].T
    why = Counter(parts[np.argmax(row)].why_not if row.any() else "not better" for row in worse)
    return [*costs, Candidates("proposals", len(names), tuple(why.items()))]
