"""Inputs from public reports on which replan was wrong: right values, or a note that says what was
mended.
"""

from pathlib import Path

import numpy as np
import pytest

from replan.core.errors import LogError
from replan.core.settings import strict
from replan.logs.agents import AgentKind
from replan.logs.kind_words import kind_of_word, kinds_of_tracks
from replan.logs.log_settings import LogSettings
from replan.logs.readers import read_log

CAR, TRUCK, BUS, MOTORCYCLE, BICYCLE, PEDESTRIAN, OBJECT = AgentKind


@pytest.fixture
def users(shared_data: Path) -> Path:
    return shared_data / "users"


def has_note(path: Path, words: str) -> bool:
    return any(words in note for note in read_log(path).notes)


def test_a_bridge_over_the_road_is_not_in_the_way(users: Path) -> None:
    scenario = read_log(users / "bridge_over_road" / "bridge.mcap")
    assert not len(scenario.tracks)
    assert any("2 road users" in note and "+6.4 to +6.5 m" in note for note in scenario.notes)


@pytest.mark.parametrize("way", ["north", "west"])
def test_the_twist_of_an_odometry_in_the_axes_of_the_map(way: str, users: Path) -> None:
    folder = users / "twist_in_map_frame"
    wrong, right = (read_log(folder / f"{way}_{name}.mcap") for name in ("map", "right"))
    np.testing.assert_allclose(wrong.ego.v, right.ego.v, atol=1e-9)
    assert any("in world axes: it fits" in note and "ego_axes" in note for note in wrong.notes)
    assert not any("axes" in note for note in right.notes)
    as_it_is = read_log(folder / f"{way}_map.mcap", LogSettings(ego_axes="own"))
    assert np.median(as_it_is.ego.v) > 9.0, "derived from the poses, which it contradicts"


def test_perception_on_gps_time(users: Path) -> None:
    gps, utc = (read_log(users / "perception_on_gps_time" / name) for name in ("gps", "utc"))
    np.testing.assert_allclose(gps.tracks.t, utc.tracks.t, atol=1e-6)
    assert any("as GPS time" in note for note in gps.notes)


def test_boxes_whose_sides_are_swapped(users: Path) -> None:
    swapped, right = (read_log(users / "box_sides_swapped" / name) for name in ("swapped", "right"))
    np.testing.assert_allclose(swapped.tracks.length, right.tracks.length)
    np.testing.assert_allclose(swapped.tracks.width, right.tracks.width)


@pytest.mark.parametrize(
    ("wrong", "right", "words"),
    [
        ("bend_radius", "bend_right", "read as the radius"),
        ("brakes_sign", "brakes_right", "read with the other sign"),
    ],
)
def test_columns_of_the_ego_that_contradict_its_positions(
    wrong: str, right: str, words: str, users: Path
) -> None:
    folder = users / "ego_columns_contradict"
    read, whole = read_log(folder / wrong), read_log(folder / right)
    np.testing.assert_allclose(read.ego.kappa, whole.ego.kappa, atol=1e-6)
    np.testing.assert_allclose(read.ego.a, whole.ego.a, atol=1e-6)
    assert has_note(folder / wrong, words)


def test_a_bus_of_which_only_the_size_is_known(users: Path) -> None:
    settings = LogSettings(car={"length": 12.0, "width": 2.55})
    scenario = read_log(users / "size_of_bus_only" / "log", settings)
    bus = scenario.vehicle
    assert (bus.wheelbase, bus.rear_overhang) == (5.9, 3.4)
    assert 10_000.0 < bus.mass < 18_000.0
    gap = scenario.tracks.x[0] - 2.25 - bus.axle_to_front - scenario.ego.x[0]
    assert gap == pytest.approx(19.15, abs=0.01), "by hand: 30 - 2.25 - 8.6"
    assert any("taken for a city bus" in note for note in scenario.notes)


def test_floating_car_data_of_sumo(users: Path, tmp_path: Path) -> None:
    path = users / "sumo_fcd" / "fcd.csv"
    columns = {
        "t": "timestep_time",
        "id": "vehicle_id",
        "x": "vehicle_x",
        "y": "vehicle_y",
        "yaw": "vehicle_angle [deg]",
        "v": "vehicle_speed",
    }
    for settings in (LogSettings(ego="veh0"), LogSettings(ego="veh0", columns=columns)):
        scenario = read_log(path, settings)
        np.testing.assert_allclose(scenario.ego.yaw, 0.0, atol=1e-9)
        assert scenario.ego.v[0] == pytest.approx(10.0)
        centre = scenario.ego.x[0] + scenario.vehicle.axle_to_center + scenario.origin[0]
        assert centre == pytest.approx(50.0 - 2.25), "a car of 4.5 m whose front is at 50 m"


def test_floating_car_data_in_xml_is_that_of_its_table(tmp_path: Path) -> None:
    rows, table = [], ["timestep_time;vehicle_angle;vehicle_id;vehicle_speed;vehicle_x;vehicle_y"]
    for k in range(60):
        t, angle = 0.1 * k, 90.0 - 0.3 * k
        yaw = np.radians(90.0 - angle)
        x, y = 80.0 * np.sin(yaw), 80.0 * (1.0 - np.cos(yaw))
        v = 80.0 * np.radians(0.3) / 0.1
        rows.append(
            f'<timestep time="{t:.2f}"><vehicle id="a" x="{x}" y="{y}" angle="{angle}" '
            f'speed="{v}" type="bus"/><person id="p" x="50" y="9" angle="0" speed="0"/></timestep>'
        )
        table.append(f"{t:.2f};{angle};a;{v};{x};{y}")
    xml, csv = tmp_path / "fcd.xml", tmp_path / "fcd.csv"
    xml.write_text(
        f"<?xml version='1.0'?>\n<!-- sumo -->\n<fcd-export>{''.join(rows)}</fcd-export>"
    )
    csv.write_text("\n".join(table))
    of_xml, of_csv = (read_log(path, LogSettings(ego="a")) for path in (xml, csv))
    np.testing.assert_allclose(of_xml.ego.yaw, of_csv.ego.yaw, atol=1e-9)
    np.testing.assert_allclose(of_xml.ego.v, of_csv.ego.v, atol=1e-9)
    assert of_xml.tracks.kinds == (PEDESTRIAN,)
    with pytest.raises(LogError, match=r"fcd\.xml.*the table has no ego, but 2 road users"):
        read_log(xml)


KINDS = {
    "nuscenes": {CAR, TRUCK, PEDESTRIAN, OBJECT, BUS, BICYCLE},
    "kitti": {CAR, BUS, PEDESTRIAN},
    "carla": {CAR, PEDESTRIAN},
    "waymo": {CAR, PEDESTRIAN},
    "apollo": {CAR, OBJECT},
    "missing": {CAR},
}


@pytest.mark.parametrize("name", KINDS)
def test_labels_of_data_sets(name: str, users: Path) -> None:
    scenario = read_log(users / "labels_of_datasets" / name)
    assert {*scenario.tracks.kinds} & KINDS[name]


WORDS = {
    CAR: "vehicle.car Car Van TYPE_VEHICLE vehicle.tesla.model3 VEHICLE REGULAR_VEHICLE passenger "
    "DEFAULT_VEHTYPE vehicle.emergency.police taxi SMALLMOT",
    TRUCK: "vehicle.truck vehicle.trailer vehicle.construction Truck vehicle.carlamotors.firetruck "
    "vehicle.carlamotors.carlacola LARGE_VEHICLE BOX_TRUCK BIGMOT delivery TRAILER",
    BUS: "vehicle.bus.bendy vehicle.bus.rigid Tram bus coach SCHOOL_BUS "
    "vehicle.mitsubishi.fusorosa tram RAILED_VEHICLE",
    MOTORCYCLE: "vehicle.motorcycle motorcyclist vehicle.harley-davidson.low_rider "
    "vehicle.yamaha.yzf moped",
    BICYCLE: "vehicle.bicycle Cyclist TYPE_CYCLIST vehicle.bh.crossbike vehicle.gazelle.omafiets "
    "BICYCLE NONMOT",
    PEDESTRIAN: "human.pedestrian.adult human.pedestrian.stroller Pedestrian Person_sitting "
    "TYPE_PEDESTRIAN walker.pedestrian.0001 PEDESTRIAN animal WHEELCHAIR DEFAULT_PEDTYPE",
    OBJECT: "movable_object.barrier movable_object.trafficcone static_object.bicycle_rack Misc "
    "DontCare TYPE_SIGN TYPE_UNKNOWN UNKNOWN_MOVABLE UNKNOWN_UNMOVABLE CONSTRUCTION_CONE BOLLARD "
    "static.prop.streetbarrier traffic.traffic_light shopping_cart",
}


@pytest.mark.parametrize(
    ("word", "kind"), [(word, kind) for kind, words in WORDS.items() for word in words.split()]
)
def test_words_of_data_sets(word: str, kind: AgentKind) -> None:
    assert kind_of_word(word) is kind
    assert kind_of_word(f" {word.upper()} ") is kind


def test_a_kind_is_that_of_most_rows() -> None:
    notes: list[str] = []
    words = ["unknown", "car", "car", "", "nan", "bus", "quad"]
    offsets = np.array([0, 3, 5, 7])
    kinds = kinds_of_tracks(words, offsets, {"quad": "bus"}, {}, notes)
    assert kinds == (CAR, CAR, BUS)
    assert ["of no kind" in notes[0], "several kinds" in notes[1]] == [True, True]


def test_all_unknown_words_are_named_at_once_and_can_be_mapped(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="an agent is a 'dragon', a 'quad'") as refused:
        kinds_of_tracks(["quad", "car", "dragon"], np.array([0, 1, 3]), {}, {}, [])
    remedy = refused.value.remedy or ""
    stated = remedy.partition("in [log]: ")[2].partition("; ")[0]
    import tomllib

    settings = strict(LogSettings, tomllib.loads(stated))
    words = ["quad", "car", "dragon"]
    assert kinds_of_tracks(words, np.array([0, 1, 3]), settings.kinds, {}, []) == (CAR, CAR)
