"""Raw detections to tracks with the whole log at hand: what the judge, traffic and drawing get."""

from __future__ import annotations

import numpy as np

from logs.agents import codes_of
from logs.detections import Detections, Repair
from logs.scenario import Tracks
from logs.states import Trajectory
from logs.vehicle import VehicleParameters


def detections_of(tracks: Tracks) -> Detections:
    """The samples of tracks as detections without scores, by which any log can be repaired."""
    owner = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets))
    order = np.lexsort((owner, tracks.t))
    columns = {name: getattr(tracks, name)[order] for name in ("t", "x", "y", "yaw", "vx", "vy")}
    who = owner[order]
    return Detections(
        frames=np.unique(tracks.t), ids=tuple(tracks.ids[i] for i in who), codes=codes_of(tracks.kinds)[who],
        length=tracks.length[who], width=tracks.width[who], score=np.full(len(who), np.nan), **columns,
    )  # fmt: skip


def repair(detections: Detections, ego: Trajectory, vehicle: VehicleParameters) -> tuple[Tracks, Repair]:
    """The road users that raw detections show, and what was done to find them. Not causal: uses the whole log.

    `ego` is the drive of the log (rear axle): far boxes count less, and nothing stands where it drove.
    """
    raise NotImplementedError
