"""Who drives, as the bags of several stacks say it."""

import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import ros_bags as bags
from command_line import replan
from ros_bags import SPEED, START_NS, Row, message, stamp
from rosbags.typesys import get_types_from_msg

from replan.core.errors import LogError
from replan.logs.driving import DrivingMode, takeovers
from replan.logs.readers import LogSettings, read_log
from replan.logs.scenario import Scenario

TYPES = bags.store()
for kind, text in {
    "autoware_msgs/msg/VehicleStatus": "std_msgs/Header header\nint32 drivemode\n"
    "int32 steeringmode\nint32 gearshift\nfloat64 speed\n",
    "pacmod3_msgs/msg/GlobalRpt": "std_msgs/Header header\nbool enabled\nbool override_active\n",
}.items():
    TYPES.register(get_types_from_msg(text, kind))
AUTO, MANUAL, STEERED, PACED, GIVEN_UP, UNKNOWN = DrivingMode
CONTROL = "autoware_vehicle_msgs/msg/ControlModeReport"
OPERATION = "autoware_adapi_v1_msgs/msg/OperationModeState"
MINI, PACMOD, FLAG = (
    "autoware_msgs/msg/VehicleStatus",
    "pacmod3_msgs/msg/GlobalRpt",
    "std_msgs/msg/Bool",
)
PEDALS = "tier4_vehicle_msgs/msg/ActuationStatusStamped"


def control(mode: int) -> dict[str, Any]:
    return {"mode": mode}


def written(
    folder: Path, rows: list[Row], settings: LogSettings | None = None, **form: Any
) -> Scenario:
    path = bags.write_ros2(folder / "bag", bags.odometry() + rows, types=TYPES, **form)
    return read_log(path, settings)


def rows_of(
    topic: str, kind: str, *spans: tuple[float, dict[str, Any]], rate: float = 20.0
) -> list[Row]:
    """A topic that repeats the values of the last span, with a stamp."""
    rows = []
    for ns in bags.times(20):
        t = (ns - START_NS) / 1e9
        _, values = [span for span in spans if span[0] <= t + 1e-6][-1]
        head = (
            {"header": bags.header(ns)} if kind in (MINI, PACMOD, PEDALS) else {"stamp": stamp(ns)}
        )
        rows.append((topic, kind, ns + 5_000_000, message(kind, TYPES, **head, **values)))
    return rows


@pytest.mark.parametrize(
    ("kind", "first", "then", "mode"),
    [
        (CONTROL, control(1), control(4), MANUAL),
        (CONTROL, control(1), control(2), STEERED),
        (CONTROL, control(1), control(3), PACED),
        (CONTROL, control(1), control(5), GIVEN_UP),
        (CONTROL, control(1), control(6), UNKNOWN),
        ("autoware_auto_vehicle_msgs/msg/ControlModeReport", control(1), control(4), MANUAL),
        (MINI, {"drivemode": 1, "steeringmode": 1}, {"drivemode": 0, "steeringmode": 0}, MANUAL),
        (MINI, {"drivemode": 1, "steeringmode": 1}, {"drivemode": 0, "steeringmode": 1}, STEERED),
        (PACMOD, {"enabled": True}, {"enabled": False}, MANUAL),
    ],
)
@pytest.mark.parametrize("sqlite", [False, True])
def test_each_stack_says_who_drives(
    tmp_path: Path,
    kind: str,
    first: dict[str, Any],
    then: dict[str, Any],
    mode: DrivingMode,
    *,
    sqlite: bool,
) -> None:
    log = written(tmp_path, rows_of("/mode", kind, (0.0, first), (3.0, then)), sqlite=sqlite)
    assert log.driving is not None
    assert [log.driving.at(t) for t in (0.5, 2.5, 3.5, 5.0)] == [AUTO, AUTO, mode, mode]
    assert log.driving.latency_s == pytest.approx(0.05)
    assert log.driving.source == "/mode"


def changes(topic: str, kind: str, *spans: tuple[float, dict[str, Any]]) -> list[Row]:
    """A topic that is written at changes only."""
    rows = []
    for t, values in spans:
        ns = START_NS + round(1e9 * t)
        head = {"stamp": stamp(ns)} if kind == OPERATION else {}
        rows.append((topic, kind, ns, message(kind, TYPES, **head, **values)))
    return rows


def operation(mode: int, *, enabled: bool) -> dict[str, Any]:
    return {"mode": mode, "is_autoware_control_enabled": enabled}


@pytest.mark.parametrize(
    ("topic", "kind", "first", "then"),
    [
        ("/vehicle/dbw_enabled", FLAG, {"data": True}, {"data": False}),
        (
            "/api/operation_mode/state",
            OPERATION,
            operation(2, enabled=True),
            operation(2, enabled=False),
        ),
    ],
)
def test_the_last_value_of_a_topic_of_changes_holds(
    tmp_path: Path, topic: str, kind: str, first: dict[str, Any], then: dict[str, Any]
) -> None:
    log = written(tmp_path, changes(topic, kind, (0.1, first), (3.0, then)))
    assert log.driving is not None and log.driving.latency_s == 0.0
    assert [log.driving.at(t) for t in (2.9, 3.1, 5.9)] == [AUTO, MANUAL, MANUAL]


def test_the_control_mode_goes_before_the_operation_mode(tmp_path: Path) -> None:
    rows = rows_of("/vehicle/status/control_mode", CONTROL, (0.0, control(1)), (3.0, control(3)))
    rows += changes("/api/operation_mode/state", OPERATION, (0.0, operation(2, enabled=True)))
    log = written(tmp_path, rows)
    assert log.driving is not None and log.driving.at(4.0) is PACED
    assert any("says (of 2 such topics)" in note for note in log.notes)
    without = LogSettings(topics={"driver": "-"})
    assert written(tmp_path / "none", rows, without).driving is None
    other = LogSettings(topics={"driver": "/api/operation_mode/state"})
    chosen = written(tmp_path / "other", rows, other).driving
    assert chosen is not None and chosen.at(4.0) is AUTO


def test_a_topic_that_falls_silent_says_nothing(tmp_path: Path) -> None:
    rows = rows_of("/mode", CONTROL, (0.0, control(1)))
    log = written(tmp_path, [row for row in rows if not 2.0 < (row[2] - START_NS) / 1e9 < 4.0])
    assert log.driving is not None
    assert [log.driving.at(t) for t in (1.9, 2.5, 3.9, 4.2)] == [AUTO, UNKNOWN, UNKNOWN, AUTO]
    assert takeovers(log.driving, log.ego, log.controls) == ([], [])


def test_a_topic_that_ends_early_says_nothing_afterwards(tmp_path: Path) -> None:
    rows = rows_of("/mode", CONTROL, (0.0, control(1)))
    log = written(tmp_path, [row for row in rows if (row[2] - START_NS) / 1e9 < 3.0])
    assert log.driving is not None
    assert [log.driving.at(t) for t in (2.9, 3.5, 5.9)] == [AUTO, UNKNOWN, UNKNOWN]


def test_a_bag_that_does_not_define_the_type_is_read_without_it(tmp_path: Path) -> None:
    rows = rows_of("/pacmod/global_rpt", PACMOD, (0.0, {"enabled": True}))
    path = bags.write_ros2(tmp_path / "bag", bags.odometry() + rows, sqlite=True, types=TYPES)
    (data,) = path.glob("*.db3")
    with sqlite3.connect(data) as file:
        file.execute("UPDATE message_definitions SET encoded_message_definition = ''")
    log = read_log(path)
    assert log.driving is None
    note = (
        "/pacmod/global_rpt may say who drives, and is not read: the bag does not define its type."
    )
    assert note in log.notes


def test_a_mode_that_begins_late_is_unknown_before(tmp_path: Path) -> None:
    rows = rows_of("/mode", CONTROL, (0.0, control(1)))
    log = written(tmp_path, [row for row in rows if (row[2] - START_NS) / 1e9 > 3.0])
    assert log.driving is not None and log.driving.at(2.9) is UNKNOWN
    assert log.driving.at(3.2) is AUTO


def test_a_flag_of_another_name_says_nothing(tmp_path: Path) -> None:
    log = written(tmp_path, changes("/door_open", FLAG, (0.1, {"data": True})))
    assert log.driving is None
    named = LogSettings(topics={"driver": "/door_open"})
    assert written(
        tmp_path / "named", changes("/door_open", FLAG, (0.1, {"data": True})), named
    ).driving
    with pytest.raises(LogError, match="'driver' is not in the log"):
        written(tmp_path / "lacks", [], LogSettings(topics={"driver": "/mode"}))


def test_the_drivers_pedal_begins_the_take_over(tmp_path: Path) -> None:
    rows = rows_of("/mode", CONTROL, (0.0, control(1)), (3.0, control(4)))
    pressed = {"status": {"accel_status": 0.0, "brake_status": 0.4, "steer_status": 0.0}}
    released = {"status": {"accel_status": 0.1, "brake_status": 0.0, "steer_status": 0.0}}
    rows += rows_of("/actuation", PEDALS, (0.0, released), (2.6, pressed))
    log = written(tmp_path, rows)
    assert log.controls is not None and np.isnan(log.controls.steer).all()
    (event,), _ = takeovers(log.driving, log.ego, log.controls) if log.driving else ((), ())
    assert event.input == "brake"
    assert event.t == pytest.approx(2.6, abs=0.03)
    assert event.changed == pytest.approx(3.0, abs=0.01)
    bag = str(tmp_path / "bag")
    shown = replan("inspect", bag).output
    assert "driven: autonomous from 0.0 to 3.0 s, manual from 3.0 to 6.0 s (/mode)" in shown
    assert replan("mine", bag, "--out", tmp_path / "mined").exit_code == 0
    events = pd.read_parquet(tmp_path / "mined" / "events.parquet").set_index("kind")
    assert events.loc["takeover", "what"] == "episode 1, brake"
    assert events.loc["takeover", "value"] == pytest.approx(SPEED, rel=0.01)


def test_the_settings_name_the_field_and_the_values_of_any_topic(tmp_path: Path) -> None:
    rows = changes("/stack/state", "std_msgs/msg/Int32", (0.1, {"data": 7}), (3.0, {"data": 2}))
    modes = {"field": "data", "7": "autonomous", "2": "steering"}
    settings = LogSettings(topics={"driver": "/stack/state"}, driver=modes)
    driving = written(tmp_path, rows, settings).driving
    assert driving is not None
    assert [driving.at(t) for t in (1.0, 4.0)] == [AUTO, STEERED]
    fewer = replace(settings, driver={"field": "data", "7": "autonomous"})
    with pytest.raises(LogError, match="who drives is '2'"):
        written(tmp_path / "fewer", rows, fewer)
    with pytest.raises(LogError, match="has no field state"):
        written(tmp_path / "wrong", rows, replace(settings, driver={"field": "state"}))


def test_a_mode_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match="driver has 'robot': known are autonomous, manual"):
        LogSettings(driver={"7": "robot"})
