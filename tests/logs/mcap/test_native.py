"""Laws of the native log: write -> read is the identity, same bytes, no half files, readable by
others; its page.
"""

import json
from dataclasses import fields, replace
from enum import Enum
from pathlib import Path

import msgspec
import numpy as np
import pytest
from differences import differences
from hypothesis import HealthCheck, given, settings
from mcap.reader import make_reader
from random_scenarios import scenarios
from rich_scenario import START_NS, rich_scenario

import replan
from replan.core.errors import LogError, OutputError
from replan.logs.mcap import format_page, native, plan_messages, read_scenario, write_scenario
from replan.logs.road import Lane, Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.vehicle import VehicleParameters

once = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@once
@given(scenarios())
def test_reading_what_was_written_is_the_identity(tmp_path: Path, scenario: Scenario) -> None:
    write_scenario(tmp_path / "log.mcap", scenario)
    assert differences(scenario, read_scenario(tmp_path / "log.mcap")) == []


def test_the_comparison_of_the_round_trip_sees_a_changed_bit() -> None:
    scenario = rich_scenario()
    vx = scenario.tracks.vx.copy()
    vx[3] = np.nextafter(vx[3], 9.0)
    assert differences(scenario, replace(scenario, tracks=replace(scenario.tracks, vx=vx))) == [
        "scenario.tracks.vx"
    ]


def test_same_scenario_same_bytes(tmp_path: Path) -> None:
    for name in ("one.mcap", "two.mcap"):
        write_scenario(tmp_path / name, rich_scenario())
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "two.mcap").read_bytes()


@pytest.mark.parametrize(
    ("noun", "message", "split"),
    [
        (
            Lane,
            native.LaneColumns,
            {
                "left": ("left_x", "left_y"),
                "right": ("right_x", "right_y"),
                "line": ("line_x", "line_y"),
            },
        ),
        (VehicleParameters, native.Vehicle, {}),
        (Road, native.Road, {}),
        (replan.StopLine, native.StopLine, {"points": ("x", "y")}),
        (replan.Crosswalk, native.Crosswalk, {"polygon": ("x", "y")}),
        (replan.Goal, native.Goal, {}),
        (replan.Decision, plan_messages.Decision, {}),
        (replan.SolverReport, plan_messages.SolverReport, {}),
        (Trajectory, plan_messages.TrajectoryColumns, {}),
    ],
)
def test_a_message_has_every_field_of_its_noun(
    noun: type, message: type, split: dict[str, tuple[str, str]]
) -> None:
    expected = {part for f in fields(noun) for part in split.get(f.name, (f.name,))}
    assert set(message.__struct_fields__) == expected


def test_a_log_tells_its_story_without_replan(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", rich_scenario())
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        seen = {
            channel.topic: (schema, json.loads(m.data))
            for schema, channel, m in reader.iter_messages(reverse=True)
        }
        record = next(m.metadata for m in reader.iter_metadata() if m.name == "replan.scenario")
        summary = reader.get_summary()
    assert record["format_version"] == "1"
    assert record["start_ns"] == str(START_NS)
    assert summary is not None and all(
        index.compression == "zstd" for index in summary.chunk_indexes
    )
    for schema, message in seen.values():
        described = json.loads(schema.data)
        assert described["type"] == "object" and "$ref" not in schema.data.decode()
        assert set(message) == set(described["properties"])
    assert seen["/ego"][1].keys() == {"x_m", "y_m", "yaw_rad", "v_mps", "a_mps2", "kappa_per_m"}
    assert seen["/agents"][1]["id"] == ["car 1"] and seen["/agents"][1]["vx_mps"] == [5.0]
    assert seen["/obstacles"][1]["id"] == ["post"]
    assert seen["/traffic_lights"][1] == {"id": [12], "colour": ["green"]}
    assert seen["/road"][1]["stop_lines"][0]["light"] == 12


def test_lights_that_change_together_share_a_message(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", rich_scenario())
    with (tmp_path / "log.mcap").open("rb") as file:
        told = [
            ((m.log_time - START_NS) / 1e9, json.loads(m.data))
            for _, _, m in make_reader(file).iter_messages("/traffic_lights")
        ]
    assert told == [
        (-0.1, {"id": [12], "colour": ["green"]}),
        (0.1, {"id": [4, 12], "colour": ["off", "yellow"]}),
        (0.2, {"id": [12], "colour": ["red"]}),
    ]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {
                "controls": replan.Controls(
                    np.zeros(1), np.array([np.inf]), np.zeros(1), np.zeros(1)
                )
            },
            "steer_rad is infinite",
        ),
        ({"goal": replan.Goal(t=(0.0, np.inf))}, "goal t is inf"),
        ({"road": Road({}, default_speed_limit=np.inf)}, "default speed limit is inf"),
        ({"start_ns": -1}, "start_ns is negative"),
        (
            {
                "lights": (
                    replan.TrafficLight(
                        3, np.array([0.0, 1e-10]), (replan.Colour.RED, replan.Colour.GREEN)
                    ),
                )
            },
            "light 3 changes twice on one nanosecond",
        ),
        (
            {"lights": (replan.TrafficLight(3, np.array([-2e9]), (replan.Colour.RED,)),)},
            "before log time 0",
        ),
        ({"ego": Trajectory(np.array([0.0, 1e-10]), *np.zeros((6, 2)))}, "one nanosecond"),
        (
            {"ego": Trajectory(np.array([-1.0]), *np.zeros((6, 1))), "start_ns": 0},
            "before log time 0",
        ),
    ],
)
def test_what_a_log_cannot_say_is_refused(
    tmp_path: Path, change: dict[str, object], words: str
) -> None:
    path = tmp_path / "log.mcap"
    with pytest.raises(LogError, match=words) as refusal:
        write_scenario(path, replace(rich_scenario(), **change))  # type: ignore[arg-type]
    assert str(path) in str(refusal.value)
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_old_log(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_scenario(path, rich_scenario())
    before = path.read_bytes()
    with pytest.raises(LogError):
        write_scenario(path, replace(rich_scenario(), goal=replan.Goal(v=(0.0, np.nan))))
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere.*cannot be written: No such file or directory"):
        write_scenario(tmp_path / "nowhere" / "log.mcap", rich_scenario())


PAGE = (Path(__file__).parents[3] / "docs" / "log_format.md").read_text(encoding="utf-8")


def test_the_page_is_written_from_the_types() -> None:
    assert format_page.markdown() + "\n" == PAGE, (
        "python -c 'from replan.logs.mcap.format_page import markdown; print(markdown())'"
    )


def test_every_field_of_every_topic_is_on_the_page() -> None:
    for topic, kind in native.TOPICS.items():
        assert f"| `{topic}` | [{kind.__name__}]" in PAGE
        _, _, section = PAGE.partition(f"### {kind.__name__}\n")
        section = section.partition("\n### ")[0]
        for field in msgspec.structs.fields(kind):
            needed = "needed" if field.required else "optional"
            (row,) = (
                line
                for line in section.splitlines()
                if line.startswith(f"| `{field.encode_name}` |")
            )
            assert row.endswith(f"| {needed} |")


class Described(Enum):
    """Words."""

    ONE = "one"


class Message(msgspec.Struct):
    """Words."""

    description: str
    word: Described


def test_the_schemas_in_a_log_have_no_docstrings() -> None:
    found = native.json_schema(Message)
    assert "Words." not in json.dumps(found) and found["properties"]["description"] == {
        "type": "string"
    }
    assert (
        found["properties"]["word"]["enum"] == ["one"]
        and found["properties"]["word"]["type"] == "string"
    )
