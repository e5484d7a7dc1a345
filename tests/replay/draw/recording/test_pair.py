"""Two drives in one recording: their entities, their distance, their first difference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import Recording
from sample_drive import drive

from logs.errors import ConfigError
from replay.draw.recording import write_recording
from replay.draw.recording.pair import difference, write_pair
from replay.draw.recording.pictures import span


def test_the_difference_of_a_drive_with_itself_is_nothing_and_turns_with_the_order() -> None:
    trace = drive()[0].trace
    other = replace(trace, ego=replace(trace.ego, x=trace.ego.x + 3.0, y=trace.ego.y - 4.0, v=trace.ego.v + 1.0))
    assert all((values == 0.0).all() for values in difference(trace, trace)[1].values())
    one, two = difference(trace, other)[1], difference(other, trace)[1]
    assert one["gap"] == pytest.approx(5.0) and (one["gap"] == two["gap"]).all()
    assert one["v"] == pytest.approx(1.0) and (one["v"] == -two["v"]).all()
    t, short = difference(trace, replace(trace, ego=trace.ego.between(0.0, 5.0)))
    assert (np.isfinite(short["gap"]) == (t <= 5.0 + 1e-9)).all()


@pytest.mark.slow
def test_both_recordings_are_in_one_with_the_place_where_they_part(tmp_path: Path) -> None:
    done, world = drive()
    trace = replace(
        done.trace, ego=replace(done.trace.ego, x=done.trace.ego.x + np.where(done.trace.ego.t > 3, 1.0, 0))
    )
    files = tmp_path / "one.rrd", tmp_path / "two.rrd"
    for file, each in zip(files, (done, replace(done, trace=trace)), strict=True):
        write_recording(file, each, world)
    write_pair(tmp_path / "pair.rrd", files, (done.trace, trace), ("first", "se_cond"))
    both, single = Recording(tmp_path / "pair.rrd"), Recording(files[0])
    for side in "AB":
        kept = {f"/{side}{entity}" for entity in single.moving if not entity.startswith("/__")}
        assert kept <= set(both.moving)
    page = both.static("/parting", "TextDocument:text").to_pylist()[0]
    assert "se\\_cond" in page and "First difference: t = 3.0" in page and "apart from t = 3.0" in page
    assert both.times("/parts") == pytest.approx([3.01], abs=0.02)
    assert span(tmp_path / "pair.rrd") == (0.0, pytest.approx(float(trace.ego.t[-1])))
    with pytest.raises(ConfigError, match="one log"):
        write_pair(tmp_path / "no.rrd", files, (done.trace, replace(trace, scenario="other")), ("a", "b"))
