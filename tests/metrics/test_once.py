"""What is worked out once for a drive is worked out once, is the same, and goes when the drive goes."""

from __future__ import annotations

import gc
import weakref

from metrics.once import last, once


class Drive:
    """Something that can be held weakly."""


def test_the_same_question_is_answered_once_and_another_anew() -> None:
    asked: list[tuple[object, ...]] = []

    @once
    def found(drive: Drive, bound: float, *, kept: bool = False) -> object:
        asked.append((drive, bound, kept))
        return object()

    one, two = Drive(), Drive()
    assert found(one, 1.0) is found(one, 1.0)
    assert found(one, 2.0) is not found(one, 1.0) and found(one, 1.0, kept=True) is not found(one, 1.0)
    assert found(two, 1.0) is not found(one, 1.0)
    assert len(asked) == 4


def test_only_the_newest_large_results_are_kept() -> None:
    asked: list[int] = []

    @last(2)
    def found(drive: Drive, number: int) -> int:
        asked.append(number)
        return number

    drive = Drive()
    for number in (1, 2, 1, 3, 2, 1):
        assert found(drive, number) == number
    assert asked == [1, 2, 3, 1], "3 put 1 out, and nothing else was asked for anew but 1"


def test_nothing_is_kept_of_a_drive_that_is_gone() -> None:
    @once
    def found(drive: Drive) -> list[int]:
        return held

    held = [1]
    drive = Drive()
    gone = weakref.ref(drive)
    assert found(drive) is held
    before = len(gc.get_referrers(held))
    del drive
    gc.collect()
    assert gone() is None and len(gc.get_referrers(held)) == before - 1
