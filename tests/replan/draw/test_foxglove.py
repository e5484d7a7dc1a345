"""Foxglove's channels beside the native ones: what they show is the scenario, and no reader of
replan sees them.

Decoded by the mcap project's own protobuf decoder, from the schemas in the file. Skipped without
the extra `foxglove`.
"""

import sys
from collections import defaultdict
from importlib.util import find_spec
from math import atan2
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from differences import differences
from handmade import drive, lanes_along, scenario, straight
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rich_scenario import START_NS, rich_scenario
from typer.testing import CliRunner

from replan.cli import app
from replan.core.errors import ConfigError
from replan.logs.catalogue import CATALOGUE
from replan.logs.mcap import read_scenario, write_scenario, write_trace
from replan.logs.scenario import Scenario
from replan.logs.trace import kept_samples
from replan.mine.mined_log import markers
from replan.replay.loop.closed_loop import run_closed_loop

needs_schemas = pytest.mark.skipif(
    find_spec("foxglove_schemas_protobuf") is None,
    reason="foxglove-schemas-protobuf (extra foxglove) is not installed",
)
RED, YELLOW, GREEN, GREY = (255, 75, 60), (255, 210, 80), (80, 220, 120), (120, 125, 135)


def written(path: Path, what: Scenario) -> Path:
    from replan.draw.foxglove import scenario_messages

    write_scenario(path, what, beside=scenario_messages(what))
    return path


def decoded(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Log times and messages of each of Foxglove's topics."""
    out: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        topics = [
            c.topic
            for c in reader.get_summary().channels.values()
            if c.message_encoding == "protobuf"
        ]
        for schema, channel, message, proto in reader.iter_decoded_messages(topics=topics):
            assert schema.encoding == "protobuf" and schema.name == proto.DESCRIPTOR.full_name
            assert schema.name.startswith("foxglove.") and channel.topic.startswith("/foxglove/")
            out[channel.topic].append((message.log_time, proto))
    return dict(out)


def native_messages(path: Path) -> list[tuple[str, int, int, bytes]]:
    with path.open("rb") as file:
        some = make_reader(file).iter_messages()
        return [
            (c.topic, m.log_time, m.sequence, m.data)
            for _, c, m in some
            if c.message_encoding == "json"
        ]


def heading(orientation: Any) -> float:
    return 2.0 * atan2(orientation.z, orientation.w)


def rgb(colour: Any) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in (colour.r, colour.g, colour.b))


@needs_schemas
def test_readers_see_the_same_log_with_and_without(tmp_path: Path) -> None:
    rich = rich_scenario()
    write_scenario(tmp_path / "plain.mcap", rich)
    path = written(tmp_path / "fox.mcap", rich)
    assert differences(rich, read_scenario(path)) == []
    assert native_messages(path) == native_messages(tmp_path / "plain.mcap")


@needs_schemas
def test_converting_marks_the_events_of_a_log(tmp_path: Path) -> None:
    log = CATALOGUE["everyday/cut_in"].scenario()
    write_scenario(tmp_path / "log.mcap", log)
    words = ["convert", str(tmp_path / "log.mcap"), "-o", str(tmp_path / "fox.mcap"), "--foxglove"]
    assert CliRunner().invoke(app, words).exit_code == 0
    said = decoded(tmp_path / "fox.mcap")["/foxglove/events"]
    assert [(time, one.name, one.message) for time, one in said] == [
        (log.start_ns + round(one.begin * 1e9), one.kind, one.words)
        for one in sorted(markers(log), key=lambda one: one.begin)
    ]
    assert "cut_in" in {one.name for _, one in said}


@needs_schemas
def test_same_scenario_same_bytes(tmp_path: Path) -> None:
    one, two = (written(tmp_path / name, rich_scenario()) for name in ("one.mcap", "two.mcap"))
    assert one.read_bytes() == two.read_bytes()


@needs_schemas
def test_boxes_stand_where_the_samples_are(tmp_path: Path) -> None:
    rich = rich_scenario()
    tracks, shown = rich.tracks, decoded(written(tmp_path / "fox.mcap", rich))
    exact = 0
    for topic in ("/foxglove/agents", "/foxglove/obstacles"):
        for time, entity in (
            (time, entity) for time, scene in shown[topic] for entity in scene.entities
        ):
            (cube,), i = entity.cubes, tracks.ids.index(entity.id)
            own, t, at = tracks.samples(i), (time - START_NS) / 1e9, cube.pose.position
            exact += np.isin([at.x + 1j * at.y], (tracks.x + 1j * tracks.y)[own]).all()
            expected = [
                np.interp(t, tracks.t[own], getattr(tracks, name)[own])
                for name in ("x", "y", "yaw")
            ]
            assert [at.x, at.y, heading(cube.pose.orientation)] == pytest.approx(expected, abs=1e-6)
            assert (cube.size.x, cube.size.y) == (tracks.length[i], tracks.width[i])
            assert at.z == 0.5 * cube.size.z
    assert exact >= 70  # at the times of samples it is the sample, to the bit
    assert [entity.id for entity in shown["/foxglove/obstacles"][0][1].entities] == ["post"]
    ids = [{entity.id for entity in scene.entities} for _, scene in shown["/foxglove/agents"]]
    # The log goes on after the last sample
    assert ids[1] == {"car 1", "walker"} and ids[-1] == set()


@needs_schemas
def test_the_ego_is_the_transform_and_its_box_is_ahead_of_the_axle(tmp_path: Path) -> None:
    rich = rich_scenario()
    shown = decoded(written(tmp_path / "fox.mcap", rich))
    transforms = [one for _, one in shown["/foxglove/tf"]]
    assert {(one.parent_frame_id, one.child_frame_id) for one in transforms} == {
        ("map", "base_link")
    }
    states = np.array(
        [(one.translation.x, one.translation.y, heading(one.rotation)) for one in transforms]
    )
    assert np.array_equal(states[:, :2], np.column_stack([rich.ego.x, rich.ego.y]))
    assert states[:, 2] == pytest.approx(rich.ego.yaw, abs=1e-12)
    assert [time for time, _ in shown["/foxglove/tf"]] == [
        START_NS + round(1e9 * t) for t in rich.ego.t
    ]
    assert all(one.timestamp.ToNanoseconds() == time for time, one in shown["/foxglove/tf"])
    ((_, scene),) = shown["/foxglove/ego"]
    (box,) = scene.entities
    assert box.frame_id == "base_link" and box.frame_locked
    assert (box.cubes[0].size.x, box.cubes[0].size.y) == (4.9, 1.9)
    assert box.cubes[0].pose.position.x == rich.vehicle.axle_to_center


@needs_schemas
def test_the_road_is_drawn_as_it_is_and_stop_lines_in_the_colour_of_their_light(
    tmp_path: Path,
) -> None:
    rich = rich_scenario()
    shown = decoded(written(tmp_path / "fox.mcap", rich))
    ((_, road),) = shown["/foxglove/road"]
    entities = {entity.id: entity for entity in road.entities}
    assert set(entities) == {"lane 3", "lane 5", "crosswalk 7", "goal"}
    for lane in rich.road.lanes.values():
        for line, side in zip(
            entities[f"lane {lane.id}"].lines, (lane.left, lane.right), strict=True
        ):
            assert np.array_equal([(p.x, p.y) for p in line.points], side)
    assert entities["crosswalk 7"].lines[0].type == 1  # a closed line
    seconds, colours = [], []
    for time, scene in shown["/foxglove/stop_lines"]:
        seconds.append(round((time - START_NS) / 1e9, 3))
        colours.append([rgb(entity.lines[0].color) for entity in scene.entities])
    assert seconds == [-0.1, 0.0, 0.1, 0.2]
    assert [first for first, _ in colours] == [GREEN, GREEN, YELLOW, RED]
    assert len({sign for _, sign in colours}) == 1


@needs_schemas
def test_every_message_shows_all_of_its_topic(tmp_path: Path) -> None:
    """A viewer that jumps shows the last message before: it removes what is older, and nothing of
    its own.
    """
    for topic, messages in decoded(written(tmp_path / "fox.mcap", rich_scenario())).items():
        for time, message in messages:
            if message.DESCRIPTOR.name == "SceneUpdate" and topic != "/foxglove/ego":
                (deletion,) = message.deletions
                assert deletion.type == 1 and deletion.timestamp.ToNanoseconds() == time
                assert all(entity.timestamp.ToNanoseconds() == time for entity in message.entities)


@needs_schemas
def test_a_trace_shows_its_plans(tmp_path: Path) -> None:
    from replan.draw.foxglove import trace_messages

    log = CATALOGUE["paper/free_road"].scenario()
    trace = run_closed_loop(log, "constant_speed").trace
    path = tmp_path / "closed.mcap"
    write_trace(tmp_path / "plain.mcap", trace, log)
    write_trace(path, trace, log, beside=trace_messages(trace, log))
    assert differences(read_scenario(tmp_path / "plain.mcap"), read_scenario(path)) == []
    shown = decoded(path)
    assert len(shown["/foxglove/plan"]) == len(shown["/foxglove/plan_line"]) == len(trace.frames)
    for frame, (_, poses), (_, line) in zip(
        trace.frames, shown["/foxglove/plan"], shown["/foxglove/plan_line"], strict=True
    ):
        kept = kept_samples(frame.plan.trajectory.t)
        expected = np.column_stack([frame.plan.trajectory.x[kept], frame.plan.trajectory.y[kept]])
        assert np.array_equal([(p.position.x, p.position.y) for p in poses.poses], expected)
        assert np.array_equal([(p.x, p.y) for p in line.entities[0].lines[0].points], expected)


@pytest.mark.slow
@needs_schemas
def test_convert_and_evaluate_write_them_and_the_verdict_stays(tmp_path: Path) -> None:
    ego = drive(straight, 8.0, 1.9)
    log = tmp_path / "log.mcap"
    write_scenario(log, scenario(ego, road=lanes_along(ego)))
    runner = CliRunner()
    done = runner.invoke(app, ["convert", str(log), "-o", str(tmp_path / "fox.mcap"), "--foxglove"])
    assert done.exit_code == 0, done.output
    assert "/foxglove/tf" in decoded(tmp_path / "fox.mcap")
    words = [
        "evaluate",
        str(log),
        "-p",
        "constant_speed",
        "--workers",
        "0",
        "--no-recording",
        "--out",
    ]
    for name, more in (("without", []), ("with", ["--foxglove"])):
        assert runner.invoke(app, [*words, str(tmp_path / name), *more]).exit_code in (0, 1, 4)
    tables = [pd.read_parquet(tmp_path / name / "metrics.parquet") for name in ("without", "with")]
    pd.testing.assert_frame_equal(*tables)
    (closed,) = (tmp_path / "with").rglob("closed.mcap")
    assert {"/foxglove/agents", "/foxglove/plan"} & set(decoded(closed)) == {"/foxglove/plan"}


def test_a_missing_package_is_named_with_its_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "foxglove_schemas_protobuf.Color_pb2", None)
    monkeypatch.delitem(sys.modules, "replan.draw.foxglove", raising=False)
    ego = drive(straight, 8.0, 1.0)
    write_scenario(tmp_path / "log.mcap", scenario(ego, road=lanes_along(ego)))
    for words in (
        ["convert", "-o", str(tmp_path / "out.mcap")],
        ["evaluate", "--out", str(tmp_path / "out")],
    ):
        done = CliRunner().invoke(
            app, [words[0], str(tmp_path / "log.mcap"), *words[1:], "--foxglove"]
        )
        assert done.exit_code == 2
        assert "pip install 'replan[foxglove]'" in done.stderr
    assert not list(tmp_path.glob("out*"))
    with pytest.raises(ConfigError, match="foxglove-schemas-protobuf"):
        import replan.draw.foxglove  # noqa: F401
