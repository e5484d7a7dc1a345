"""Damaged, foreign and wrong logs: one LogError line with file, topic, time and remedy, and never
anything else.
"""

import itertools
import json
import math
import struct
from pathlib import Path
from typing import Any

import pytest
from differences import differences
from hand_written_mcap import RECORD, STATE, TABLE, ego_states, write_by_hand
from hypothesis import HealthCheck, given, settings, strategies as st
from mcap.opcode import Opcode
from mcap.writer import Writer
from rich_scenario import rich_scenario

from replan.core.errors import LogError
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.mcap.records import BEGIN, HEAD, salvage
from replan.logs.road import RoadSource
from replan.logs.rules import Colour
from replan.logs.summary import summarise

fuzz = settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(scope="module")
def small_log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("small") / "log.mcap"
    write_scenario(path, rich_scenario(4))
    return path.read_bytes()


def survives(path: Path, raw: bytes) -> None:
    """The file is refused in one line, or read as if nothing had happened."""
    path.write_bytes(raw)
    try:
        scenario = read_scenario(path)
    except LogError as error:
        assert str(path) in str(error) and "\n" not in str(error)
        assert summarise(path).error is not None
    else:
        assert differences(rich_scenario(4), scenario) == []


@fuzz
@given(st.data())
def test_flipped_bytes_are_refused_or_change_nothing(
    tmp_path: Path, small_log: bytes, data: st.DataObject
) -> None:
    raw = bytearray(small_log)
    for place in data.draw(st.lists(st.integers(0, len(raw) - 1), min_size=1, max_size=4)):
        raw[place] ^= data.draw(st.integers(1, 255))
    survives(tmp_path / "log.mcap", bytes(raw))


@fuzz
@given(st.data())
def test_a_cut_is_refused(tmp_path: Path, small_log: bytes, data: st.DataObject) -> None:
    end = data.draw(st.integers(0, len(small_log) - 1))
    (tmp_path / "log.mcap").write_bytes(small_log[:end])
    with pytest.raises(LogError):
        read_scenario(tmp_path / "log.mcap")
    hole = data.draw(st.integers(0, end))
    survives(tmp_path / "log.mcap", small_log[:hole] + small_log[end:])


@fuzz
@given(
    st.lists(
        st.tuples(
            st.sampled_from(
                [
                    "/ego",
                    "/agents",
                    "/agents/table",
                    "/road",
                    "/goal",
                    "/vehicle",
                    "/traffic_lights",
                ]
            ),
            st.integers(0, 2**64 - 1),
            st.binary(max_size=30)
            | st.recursive(
                st.none() | st.floats() | st.integers() | st.text(max_size=3),
                lambda inner: (
                    st.dictionaries(st.sampled_from(["x_m", "id", "lanes", "regions"]), inner)
                    | st.lists(inner)
                ),
                max_leaves=5,
            ),
        ),
        max_size=4,
    )
)
def test_garbage_in_a_sound_container_is_refused(
    tmp_path: Path, messages: list[tuple[str, int, Any]]
) -> None:
    path = write_by_hand(tmp_path / "log.mcap", [*messages, ("/ego", 2**62, {"x_m": "far"})])
    with pytest.raises(LogError) as refusal:
        read_scenario(path)
    assert str(path) in str(refusal.value) and "\n" not in str(refusal.value)


def refusal(path: Path) -> str:
    with pytest.raises(LogError) as error:
        read_scenario(path)
    text = str(error.value)
    # A remedy follows the semicolon
    assert text.startswith(str(path)) and "\n" not in text and "; " in text
    assert summarise(path).lines()[-1] == f"error: {text}"
    return text


def agents(time: int = 0, **changes: Any) -> tuple[str, int, Any]:
    return ("/agents", time, {"id": ["a"], "x_m": [0.0], "y_m": [0.0], "yaw_rad": [0.0], **changes})


def road(**rules: Any) -> tuple[str, int, Any]:
    return ("/road", 0, {"lanes": [LANE], **rules})


def shows(time: int, **changes: Any) -> tuple[str, int, Any]:
    return ("/traffic_lights", time, {"id": [5], "colour": ["red"], **changes})


LANE = {"id": 1, "left_x_m": [0, 9], "left_y_m": [1, 1], "right_x_m": [0, 9], "right_y_m": [-1, -1]}
STOP = {"id": 7, "lane": 1, "x_m": [8, 8], "y_m": [1, -1], "light": 5}
ZEBRA = {"id": 3, "x_m": [4, 6, 6, 4], "y_m": [-1, -1, 1, 1]}
HELD = [("/agents/table", 0, TABLE)]


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        ([("/goal", 0, {})], "topic /ego: the log has no ego states"),
        (
            [*ego_states(3), ("/ego", 300_000_000, {**STATE, "yaw_rad": math.nan})],
            "/ego, time 0.300 s: yaw_rad is NaN",
        ),
        (
            [("/ego", 10**9, {**STATE, "x_m": math.inf})],
            "topic /ego, time 1.000 s: x_m is Infinity",
        ),
        ([("/ego", 10**9, {**STATE, "x_m": None})], r"time 1.000 s: .*got null - at \$.x_m"),
        ([("/ego", 10**9, b'{"x_m":1e999}')], r"Number out of range - at \$.x_m"),
        ([("/ego", 10**9, {"x_m": 1.0})], "missing required field y_m"),
        (
            [("/ego", 10**9, b'{"x_m": 1.0, "y')],
            "time 1.000 s: message does not fit: Input data was truncated",
        ),
        ([("/ego", 10**9, b"\xff\xfe")], "JSON is malformed"),
        (
            [*ego_states(3), ("/ego", 100_000_000, STATE)],
            "topic /ego, time 0.100 s: time goes backwards, from 0.200 s",
        ),
        (
            [*ego_states(3), ("/ego", 200_000_000, STATE)],
            "time 0.200 s: two messages have the same time",
        ),
        (
            [*ego_states(), ("/road", 0, {}), ("/road", 0, {})],
            "topic /road, time 0.000 s: 2 messages, expected one",
        ),
        (
            [*ego_states(), ("/road", 0, {"lanes": [{**LANE, "left_x_m": [0.0]}]})],
            "lane 1 has 1 left_x_m and 2 left_",
        ),
        ([*ego_states(), ("/road", 0, {"lanes": [LANE, LANE]})], "two lanes have the same id"),
        (
            [*ego_states(), road(stop_lines=[{**STOP, "lane": 2}])],
            "/road: stop line 7 lies across lane 2, which is not in",
        ),
        ([*ego_states(), road(stop_lines=[STOP, STOP])], "/road: two stop lines have the same id"),
        (
            [*ego_states(), road(stop_lines=[{**STOP, "x_m": [8]}])],
            "/road: stop line 7 has 1 x_m and 2 y_m",
        ),
        (
            [*ego_states(), road(stop_lines=[{**STOP, "x_m": [8], "y_m": [1]}])],
            "/road: stop line 7: it needs two finite",
        ),
        (
            [*ego_states(), road(crosswalks=[{**ZEBRA, "y_m": [0]}])],
            "/road: crosswalk 3 has 4 x_m and 1 y_m",
        ),
        (
            [*ego_states(), road(crosswalks=[{**ZEBRA, "x_m": [0], "y_m": [0]}])],
            "/road: crosswalk 3: .* three points",
        ),
        (
            [*ego_states(), road(crosswalks=[ZEBRA, ZEBRA])],
            "/road: two crosswalks have the same id",
        ),
        (
            [*ego_states(), shows(0, colour=["pink"])],
            "/traffic_lights, time 0.000 s: .*Invalid enum value 'pink'",
        ),
        (
            [*ego_states(), shows(0, colour=[])],
            "/traffic_lights, time 0.000 s: columns differ in length: id 1, colour 0",
        ),
        ([*ego_states(), shows(9), shows(8)], "/traffic_lights, time 0.000 s: time goes backwards"),
        (
            [*ego_states(), shows(0), shows(0)],
            "/traffic_lights, time 0.000 s: light 5 has two colours at one time",
        ),
        (
            [*ego_states(), ("/goal", 0, {"regions": [{"x_m": [0], "y_m": []}]})],
            "topic /goal: a region needs",
        ),
        (
            [*ego_states(), ("/vehicle", 0, {"length_m": -1.0})],
            "topic /vehicle: vehicle length must be positive",
        ),
        ([*ego_states(), agents()], "topic /agents/table: there are agents, but no table"),
        (
            [*ego_states(), *HELD, agents(id=["b"])],
            "topic /agents, time 0.000 s: agent 'b' is not in /agents/table",
        ),
        ([*ego_states(), *HELD, agents(x_m=[0.0, 1.0])], "columns differ in length: id 1, x_m 2"),
        (
            [*ego_states(), *HELD, agents(x_m=[None])],
            r"topic /agents, time 0.000 s: .*at \$.x_m\[0\]",
        ),
        (
            [*ego_states(), *HELD, agents(5), agents(4)],
            "topic /agents, time 0.000 s: time goes backwards",
        ),
        ([*ego_states(), *HELD, agents(5), agents(5)], "agent 'a' has two samples at one time"),
        (
            [*ego_states(), ("/agents/table", 0, {**TABLE, "kind": ["ufo"]}), agents()],
            "Invalid enum value 'ufo'",
        ),
        (
            [*ego_states(), ("/agents/table", 0, {**TABLE, "width_m": [0]}), agents()],
            "length and width must be positive",
        ),
    ],
)
def test_a_broken_message_is_named(
    tmp_path: Path, messages: list[tuple[str, int, Any]], words: str
) -> None:
    path = write_by_hand(tmp_path / "log.mcap", messages)
    with pytest.raises(LogError, match=words) as error:
        read_scenario(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format_version": "3"}, "format version 3 is newer than 2, .*; update replan"),
        ({"format_version": "one"}, "format_version is 'one'"),
        ({"format_version": "9" * 9999}, "format_version"),
        ({"start_ns": "soon"}, "start_ns is 'soon'"),
        ({"start_ns": "99999999999999999999"}, "start_ns is 99999999999999999999"),
        ({"duration_s": "0.1"}, "shorter than its ego log"),
        ({"tags": "urban"}, "tags is 'urban'"),
    ],
)
def test_a_broken_metadata_record_is_named(
    tmp_path: Path, change: dict[str, str], words: str
) -> None:
    record = {"replan.scenario": {**RECORD["replan.scenario"], **change}}
    with pytest.raises(LogError, match=words):
        read_scenario(write_by_hand(tmp_path / "log.mcap", ego_states(), record))


def test_damage_is_named_with_its_remedy(tmp_path: Path, small_log: bytes) -> None:
    path = tmp_path / "log.mcap"

    def given_bytes(raw: bytes) -> str:
        path.write_bytes(raw)
        return refusal(path)

    assert "the file is empty" in given_bytes(b"")
    assert "wrong magic" in given_bytes(b"NOTMCAP!" + small_log[8:])
    assert "cut off" in given_bytes(small_log[:-4])
    assert (
        "/ego, time 1700000000.423 s: the file is cut off or damaged: these are the last"
        in given_bytes(small_log[:-400])
    )
    assert "unknown compression 'zst9'" in given_bytes(
        small_log.replace(b"\x04\0\0\0zstd", b"\x04\0\0\0zst9")
    )
    flipped = bytearray(small_log)
    flipped[small_log.find(b"\x04\0\0\0zstd") + 60] ^= 0xFF
    assert "time 1700000000.023 s: the chunk that begins there is damaged" in given_bytes(
        bytes(flipped)
    )
    assert "no messages" in refusal(write_by_hand(path, []))
    assert "no such file" in str(summarise(tmp_path / "nowhere.mcap").error)
    assert "not a log that replan reads; the folder holds" in str(summarise(tmp_path).error)


def test_foreign_mcap_files_are_refused_by_their_schemas(shared_data: Path) -> None:
    for name, schema in (("talker", "std_msgs/msg/String"), ("cdr_test_0", "test_msgs/msg/Arrays")):
        path = shared_data / "rosbag2" / f"{name}.mcap"
        with pytest.raises(LogError, match=schema):
            read_scenario(path)
        assert "nothing in the bag says where the ego is" in summarise(path).lines()[-1]


def test_a_log_of_ego_states_alone_is_a_scenario(tmp_path: Path) -> None:
    states = [
        ("/ego", 10**8 * k, {"x_m": 0.5 * k * k, "y_m": 0, "yaw_rad": 0.01 * k, "v_mps": 10.0 * k})
        for k in range(9)
    ]
    scenario = read_scenario(write_by_hand(tmp_path / "log.mcap", states))
    assert scenario.road.source is RoadSource.DRIVEN_PATH
    assert scenario.road.default_speed_limit * 3.6 == pytest.approx(300.0)
    assert scenario.ego.a == pytest.approx([0.0] + 8 * [100.0])
    assert scenario.ego.kappa[3] == pytest.approx(0.01 / 2.5)
    assert (len(scenario.tracks), scenario.goal, scenario.controls) == (0, None, None)
    assert scenario.duration == pytest.approx(0.8)
    told = " ".join(scenario.notes)
    assert all(word in told for word in ("no lanes", "acceleration", "curvature", "vehicle"))
    assert all(
        scenario.road.is_drivable(x, y)
        for x, y in zip(scenario.ego.x - 0.9, scenario.ego.y, strict=True)
    )


@pytest.mark.parametrize(
    ("v", "limit"), [(2.0, 20.0), (8.0, 35.0), (50.0 / 3.6, 55.0), (33.0, 135.0)]
)
@pytest.mark.parametrize("standing", [0, 20])
def test_the_limit_of_a_driven_path_is_that_of_its_drive(
    tmp_path: Path, v: float, limit: float, standing: int
) -> None:
    """10 % above the speed, up to the next 5 km/h; a stop and a moment of speeding do not count."""
    speeds = [v] * 30 + [0.0] * standing + [v] * 25 + [3.0 * v]
    x = [0.0, *itertools.accumulate(0.05 * (a + b) for a, b in itertools.pairwise(speeds))]
    states = [
        ("/ego", 10**8 * k, {"x_m": x[k], "y_m": 0, "yaw_rad": 0, "v_mps": one})
        for k, one in enumerate(speeds)
    ]
    road = read_scenario(write_by_hand(tmp_path / "log.mcap", states)).road
    assert road.limit(0) * 3.6 == pytest.approx(limit, abs=0.01)
    assert road.assumed_limits == {0}


def test_curvature_in_reverse_and_at_rest(tmp_path: Path) -> None:
    """Backwards along a circle to the left of the car: kappa stays positive; at rest it holds."""
    bare = {key: STATE[key] for key in ("x_m", "y_m", "yaw_rad", "v_mps")}
    angles = [0.0, -0.1, -0.2, -0.2]
    states = [
        (
            "/ego",
            10**9 * k,
            {
                **bare,
                "x_m": 10 * math.sin(w),
                "y_m": 10 - 10 * math.cos(w),
                "yaw_rad": w,
                "v_mps": v,
            },
        )
        for k, (w, v) in enumerate(zip(angles, (-1.0, -1.0, -1.0, 0.0), strict=True))
    ]
    kappa = read_scenario(write_by_hand(tmp_path / "log.mcap", states)).ego.kappa
    assert kappa == pytest.approx([0.0, 0.1, 0.1, 0.1], rel=1e-3)


def test_a_log_without_rules_is_read(tmp_path: Path) -> None:
    """As logs were before they could tell of rules."""
    scenario = read_scenario(write_by_hand(tmp_path / "log.mcap", [*ego_states(), road()]))
    assert (scenario.lights, scenario.road.stop_lines, scenario.road.crosswalks) == ((), (), ())
    assert any(
        line.endswith("right of way: the log names none")
        for line in summarise(tmp_path / "log.mcap").lines()
    )
    assert scenario.road.lanes[1].yields_to == ()


def test_a_light_that_the_log_does_not_show_is_a_note_told_once(tmp_path: Path) -> None:
    path = write_by_hand(tmp_path / "log.mcap", [*ego_states(), road(stop_lines=[STOP])])
    scenario = read_scenario(path)
    (told,) = [note for note in scenario.notes if "lights of 1 of 1 stop lines" in note]
    write_scenario(path, scenario)
    assert read_scenario(path).notes.count(told) == 1
    shown = read_scenario(write_by_hand(path, [*ego_states(), road(stop_lines=[STOP]), shows(0)]))
    assert told not in shown.notes and shown.lights[0].at(0.3) is Colour.RED


@pytest.mark.parametrize("in_chunk", [False, True])
def test_millions_of_records_that_hold_nothing_are_refused_at_once(
    tmp_path: Path, small_log: bytes, in_chunk: bool
) -> None:
    """They are read to a bound, and the messages before them are kept."""
    records = (b"\x80" + bytes(8)) * 1_000_000
    if in_chunk:
        head = struct.pack("<QQQII", 0, 0, len(records), 0, 0) + struct.pack("<Q", len(records))
        records = b"\x06" + struct.pack("<Q", len(head) + len(records)) + head + records
    end = 8 + 9 + int.from_bytes(small_log[9:17], "little")
    path = tmp_path / "log.mcap"
    path.write_bytes(small_log[:end] + records + small_log[end:])
    assert "more than 10000 records of types that MCAP does not define" in refusal(path)


@pytest.mark.parametrize(
    ("lost", "what"),
    [
        (Opcode.MESSAGE, "it holds 8 messages, and its statistics state 9"),
        (Opcode.DATA_END, "the file has no end of data record"),
    ],
)
def test_a_record_that_is_lost_is_refused_with_a_remedy_that_works(
    lost: Opcode, what: str, tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file, use_chunking=False)
        writer.start()
        for name, record in RECORD.items():
            writer.add_metadata(name, dict(record))
        schema = writer.register_schema("by.hand/ego", "jsonschema", b'{"type":"object"}')
        channel = writer.register_channel("/ego", "json", schema)
        for _, time, value in ego_states(9):
            writer.add_message(channel, time, json.dumps(value).encode(), time)
        writer.finish()
    raw, place = path.read_bytes(), BEGIN
    while raw[place] != lost:
        place += HEAD + int.from_bytes(raw[place + 1 : place + HEAD], "little")
    end = place + HEAD + int.from_bytes(raw[place + 1 : place + HEAD], "little")
    path.write_bytes(raw[:place] + raw[end:])
    assert what in refusal(path) and "replan salvage" in refusal(path)
    salvage(path, tmp_path / "saved.mcap")
    assert len(read_scenario(tmp_path / "saved.mcap").ego) in (8, 9)
