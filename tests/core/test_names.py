"""Short names of road users: unique, whatever the order, and only codes are shortened."""

import string
from random import Random

from hypothesis import given, strategies as st

from replan.core.names import LEAST, LONGEST, ShortNames

CODES = (
    st.uuids().map(str)
    | st.text("0123456789abcdef-", min_size=9, max_size=40)
    | st.text("01", min_size=9)
)
WORDS = st.text(string.ascii_letters + string.digits + " _~:.-", min_size=1, max_size=20)
PARTS = CODES.map("copy of {}".format) | CODES.map("{}~static".format)
IDS = st.lists(CODES | WORDS | PARTS, unique=True, max_size=12)


@given(IDS, st.randoms(use_true_random=False))
def test_unique_in_any_order_and_never_longer(ids: list[str], random: Random) -> None:
    short, mixed = ShortNames(ids), random.sample(ids, len(ids))
    names = [short(name) for name in ids]
    assert len(set(names)) == len(ids)
    assert [ShortNames(mixed)(name) for name in ids] == names
    assert all(len(shown) <= len(name) for shown, name in zip(names, ids, strict=True))
    assert all(
        shown == name for shown, name in zip(names, ids, strict=True) if len(name) <= LONGEST
    )
    assert [short.whole(name) for name in ids] == ids


@given(st.sets(st.uuids().map(str), min_size=1, max_size=12))
def test_a_uuid_is_found_by_its_short_name_and_replaced_in_sentences(ids: set[str]) -> None:
    short = ShortNames(ids)
    for name in ids:
        assert LEAST <= len(short(name)) < len(name) and short(name) in (
            name[: len(short(name))],
            name[-len(short(name)) :],
        )
        assert short.whole(short(name)) == name
        assert (
            short(f"car {name}: from behind; copy of {name}")
            == f"car {short(name)}: from behind; copy of {short(name)}"
        )


def test_words_and_codes_of_others_stay() -> None:
    short = ShortNames(["23f7a1c8-0d5e-4b8e-9a53-6a3ef1f0c2b4", "23f8", "oncoming_car_1", "17"])
    assert (
        short("23f7a1c8-0d5e-4b8e-9a53-6a3ef1f0c2b4 meets oncoming_car_1")
        == "23f7 meets oncoming_car_1"
    )
    assert (
        short("7fab2350-7eaf-3b7e-a39d-6937a4c1bede at 12345678901 s")
        == "7fab2350-7eaf-3b7e-a39d-6937a4c1bede at 12345678901 s"
    )
    assert ShortNames(["1600000000001", "1600000000002"])("1600000000002") == "0002"
    assert ShortNames(["23f7a1c8-0d5e", "23f7", "999912345"])("23f7a1c8-0d5e") == "23f7a"
