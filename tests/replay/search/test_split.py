"""Training and held-out logs: a share of each stratum, whatever the order of the arguments."""

from __future__ import annotations

from collections import Counter
from math import floor

from hypothesis import given
from hypothesis import strategies as st

from metrics.judge.aggregate import LogLabels
from replay.search.gains import held_out

NAMES = st.dictionaries(st.text("abcdefgh", min_size=1, max_size=6), st.sampled_from(["a", "b", "c", ""]), max_size=40)


@given(NAMES, st.floats(0.0, 1.0))
def test_the_share_is_held_out_of_all_logs_and_of_each_stratum(families: dict[str, str], share: float) -> None:
    labels = {name: LogLabels(family) for name, family in families.items()}
    held = held_out(labels, share)
    assert len(held) == floor(len(labels) * share + 1e-9) and held <= set(labels)
    sizes, mine = Counter(families.values()), Counter(families[name] for name in held)
    assert all(abs(mine[family] - share * size) < 1.0 + 1e-6 for family, size in sizes.items())


@given(NAMES, st.randoms())
def test_the_order_of_the_logs_does_not_matter(families: dict[str, str], random: st.DataObject) -> None:
    labels = {name: LogLabels(dataset=family) for name, family in families.items()}
    names = list(labels)
    random.shuffle(names)  # type: ignore[attr-defined]
    assert held_out({name: labels[name] for name in names}, 0.3) == held_out(labels, 0.3)
