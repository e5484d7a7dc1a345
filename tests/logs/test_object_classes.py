"""What objects are (cone, barrier, sign): kept with the log, and shown with the frames."""

from dataclasses import replace
from pathlib import Path

import pytest
from drives import car, world

from replan.logs.agents import AgentKind, ObjectClass
from replan.logs.edit.cut import cut
from replan.logs.frame import Frame
from replan.logs.kind_words import kind_of_word, object_classes
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers.arrow123d_boxes import AV2_CATEGORIES, CLASSES
from replan.logs.scenario import Scenario
from replan.replay.loop_config import DEFAULT_LOOP
from replan.replay.perception import Perception
from replan.replay.planner_process.messages import (
    Frame as FrameMessage,
    decode,
    encode,
    frame_message,
    frame_of,
)
from replan.replay.world import World

CLASS_OF = {"7": ObjectClass.CONE, "later": ObjectClass.SIGN}
"""Of the object, and of one that is not there."""


def with_a_cone() -> Scenario:
    log = world(5.0, car(30.0, 2.0, 0.0, kind=AgentKind.OBJECT))
    return replace(log, object_classes=CLASS_OF)


def shown(log: Scenario) -> Frame:
    ego = log.ego.at(0.0)
    return Perception(log, DEFAULT_LOOP).frame(World(ego, log.tracks), None)


def test_a_frame_names_the_classes_of_what_is_seen() -> None:
    assert shown(with_a_cone()).object_classes == {"7": ObjectClass.CONE}
    assert shown(replace(with_a_cone(), object_classes={})).object_classes == {}


def test_a_planner_in_its_own_process_sees_the_same() -> None:
    frame = shown(with_a_cone())
    again = frame_of(decode(encode(frame_message(frame)), FrameMessage))
    assert again.object_classes == frame.object_classes
    plain = replace(frame, object_classes={})
    assert b"object_classes" not in encode(frame_message(plain))


def test_a_written_log_keeps_them(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", with_a_cone())
    again = read_scenario(tmp_path / "log.mcap")
    assert again.object_classes == CLASS_OF
    assert cut(again, 1.0).object_classes == again.object_classes


@pytest.mark.parametrize(
    ("word", "named"),
    [
        ("TRAFFIC_CONE", ObjectClass.CONE),
        ("TYPE_PYLON", ObjectClass.CONE),
        ("construction_barrel", ObjectClass.CONE),
        ("movable_object.barrier", ObjectClass.BARRIER),
        ("STOP_SIGN", ObjectClass.SIGN),
        ("debris", None),
        ("", None),
    ],
)
def test_words_of_data_sets_name_a_class(word: str, named: ObjectClass | None) -> None:
    classes = object_classes(["a"], [AgentKind.OBJECT], [word])
    assert classes == ({} if named is None else {"a": named})
    assert not object_classes(["a"], [AgentKind.CAR], [word])


def test_both_forms_of_argoverse_name_the_same_classes() -> None:
    by_number = {
        str(number): named
        for named, numbers in CLASSES["AV2SensorBoxDetectionLabel"].items()
        for number in numbers
    }
    ids = list(map(str, range(len(AV2_CATEGORIES))))
    kinds = [kind_of_word(word) or AgentKind.OBJECT for word in AV2_CATEGORIES]
    by_word = object_classes(ids, kinds, AV2_CATEGORIES)
    assert by_word == by_number
