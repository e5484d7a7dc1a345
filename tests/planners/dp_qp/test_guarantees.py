"""Whether speeds from which the ego could stop for others are kept where they are driven."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from replan.core.arrays import FloatArray
from replan.logs.catalogue import CATALOGUE
from replan.planners.dp_qp.speed import stage
from replan.planners.dp_qp.speed.caps import (
    LEAST_MPS,
    OTHERS,
    LoweredLimit,
    PathView,
    Producer,
    SpeedCap,
    lower_limit,
)
from replan.planners.dp_qp.speed.qp import SpeedQpConfig
from replan.planners.frenet.path import Path
from replan.planners.frenet.profiles import STEP_S, braking
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig

SOON_S, SOON_MPS = 2.0, 0.06
"""What is driven soon keeps the speed, but for the QP's tolerance."""
LATER_MPS = 0.4
"""A plan for later may be faster by this: the QP's bound of v at a time is that at the station of
its reference then, which may be past the capped stretch before the ego is. It is planned anew
before the ego is there."""


@dataclass(frozen=True)
class Passage:
    """A planned passage of a capped place: when, s, and by how much faster than the cap, m/s."""

    t: float
    excess: float


@dataclass(frozen=True)
class Recorded:
    """A planned speed and the least of the caps that guarantee something along its path `(m,)`,
    m/s; inf: none.
    """

    path: Path
    caps: FloatArray
    start: tuple[float, float]
    profile: FloatArray

    def passages(self) -> Iterator[Passage]:
        """Of the places for which the ego is not too fast already to brake as gently as it does for
        any limit.
        """
        config, (s, v, _), times = (
            SpeedQpConfig(),
            self.profile,
            STEP_S * np.arange(self.profile.shape[1]),
        )
        ease = braking(*self.start, config.ease_mps2, config.comfort.jerk_mps3, STEP_S, len(times))
        for i in np.flatnonzero(
            np.isfinite(self.caps) & (self.path.sigma > 0.0) & (self.path.sigma < s[-1])
        ):
            at, cap = self.path.sigma[i], self.caps[i]
            if ease[0, -1] < at or np.interp(at, ease[0], ease[1]) <= cap:
                yield Passage(float(np.interp(at, s, times)), float(np.interp(at, s, v) - cap))


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> list[Recorded]:
    """What the speed stage is asked and answers, of all lanes."""
    found, seen = [], []
    choose = stage.SpeedStage.choose

    def watched(producer: Producer) -> Producer:
        def caps(view: PathView) -> tuple[SpeedCap, ...]:
            made = producer(view)
            seen.extend(
                (view, cap)
                for cap in made
                if cap.is_bound and np.isfinite(cap.s_from) and cap.v > LEAST_MPS
            )
            return made

        return caps

    def chosen(self: stage.SpeedStage, scene: object, path: Path, *more: object) -> object:
        seen.clear()
        answer = choose(self, scene, path, *more)  # type: ignore[arg-type]
        if answer[0].profile is not None and seen:
            free = LoweredLimit(seen[0][0].limit, np.zeros(len(path.s), np.bool_))
            caps = lower_limit(path.sigma, free, [cap for _, cap in seen])
            v = np.where(caps.is_bound, caps.v, np.inf)
            found.append(Recorded(path, v, (scene.v, scene.start.a), answer[0].profile))  # type: ignore[attr-defined]
        return answer

    monkeypatch.setattr(stage, "OTHERS", tuple(watched(producer) for producer in OTHERS))
    monkeypatch.setattr(stage.SpeedStage, "choose", chosen)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changed", "perception"),
    [
        ("pedestrian/group", {}, "sensor"),
        ("pedestrian/both_sides", {}, "sensor"),
        ("pedestrian/hesitates", {"distance_m": 16.0}, "ground_truth"),
        ("pedestrian/runs_out", {}, "sensor"),
        ("paper/static_obstacles", {"ego_speed_mps": 12.0}, "sensor"),
        ("everyday/cyclist", {}, "sensor"),
    ],
)
def test_a_possible_stop_bounds_the_speed(
    name: str, changed: Mapping[str, float], perception: str, recorded: list[Recorded]
) -> None:
    """Beside hidden ground, beside who hesitates, beside who goes along the lane."""
    family = CATALOGUE[name]
    run_closed_loop(
        family.build({**family.parameters, **changed}),
        "dp_qp",
        config=LoopConfig(perception=perception),
    )
    passages = [passage for one in recorded for passage in one.passages()]
    assert passages
    assert max((one.excess for one in passages if one.t <= SOON_S), default=0.0) <= SOON_MPS
    assert max(one.excess for one in passages) <= LATER_MPS
