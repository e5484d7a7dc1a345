"""A user's metric or planner that raises or gives nonsense costs itself only, and is named with
file and line.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from short_logs import QUICK, run

from replan.core.errors import ConfigError, raised
from replan.metrics import METRICS

HEAD = """
import numpy as np
from replan import Metric, Mode, Reduction, Series, Unavailable
from replan.metrics.reductions import MAX, MEAN

def metric(name, measure, reductions=(MEAN, MAX), **more):
    return Metric(name, "m", "none", (Mode.OPEN, Mode.CLOSED), measure, reductions, "For a test.", **more)

SOUND = metric("sound", lambda trace, scenario: Series(trace.ego.t, trace.ego.x))
"""  # noqa: E501
BAD = {
    "raises": "def bad(trace, scenario):\n    return 1 / 0",
    "in_numpy": "def bad(trace, scenario):\n    return np.linalg.inv(np.zeros((2, 2)))",
    "leaves": "def bad(trace, scenario):\n    raise SystemExit(0)",
    "none": "def bad(trace, scenario):\n    pass",
    "number": "def bad(trace, scenario):\n    return 7.0",
    "infinite": "def bad(trace, scenario):\n    return Series(trace.ego.t, trace.ego.x + np.inf)",
    "length": "def bad(trace, scenario):\n    return Series(trace.ego.t, trace.ego.x[1:])",
    "nan_time": "def bad(trace, scenario):\n    return Series(trace.ego.t * np.nan, trace.ego.x)",
    "words": (
        "def bad(trace, scenario):\n    return Series(trace.ego.t, np.full(len(trace.ego.t), 'x'))"
    ),
    "part": "def bad(trace, scenario):\n    return {'a': [1.0]}",
    "reason": "def bad(trace, scenario):\n    return Unavailable(None)",
    "writes": "def bad(trace, scenario):\n    trace.ego.x[0] = 9.0",
    "silent": "class E(Exception):\n    def __str__(self):\n        return 1 / 0\n"
    "def bad(trace, scenario):\n    raise E",
    "reduction": "def ok(trace, scenario):\n    return Series(trace.ego.t, trace.ego.x)\n"
    "def bad(series):\n    return 1 / 0",
    "pair": "def ok(trace, scenario):\n    return Series(trace.ego.t, trace.ego.x)\n"
    "def bad(series):\n    return 'seven', 0",
    "step": "def ok(trace, scenario):\n    return Series(trace.ego.t, trace.ego.x)\n"
    "def bad(series):\n    return 7.0, 10**6",
}


@pytest.fixture(scope="module")
def without(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """The metrics of a run with the sound metric alone."""
    folder = tmp_path_factory.mktemp("without")
    (folder / "mine_sound.py").write_text(HEAD, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        return run(
            logs / "a.mcap",
            folder / "out",
            replace(QUICK, mode="open", metrics=("mine_sound:SOUND",)),
        ).metrics


@pytest.mark.parametrize("bad", BAD)
def test_a_metric_that_fails_costs_itself_only(
    logs: Path, without: pd.DataFrame, tmp_path: Path, module: Callable[[str, str], str], bad: str
) -> None:
    body = f"{HEAD}\n{BAD[bad]}\n"
    last = (
        "metric('bad', ok, (MAX, Reduction('odd', bad)))"
        if "def ok" in body
        else "metric('bad', bad)"
    )
    name = module(f"mine_{bad}", f"{body}\nBAD = {last}\n")
    config = replace(QUICK, mode="open", metrics=(f"{name}:BAD", f"{name}:SOUND"))
    found = run(logs / "a.mcap", tmp_path / "with", config)
    theirs = found.metrics["metric"].str.startswith("bad")
    assert found.metrics[~theirs].reset_index(drop=True).equals(without)
    lost = found.metrics[theirs & ~found.metrics["available"]]
    line = body[: body.index("def bad")].count("\n") + 1
    where = [f"({name}.py:{number})" for number in (line, line + 1)]
    assert len(lost) and all(
        any(place in reason for place in where) for reason in lost["reason"]
    ), lost["reason"]
    assert set(found.metrics[theirs]["metric"]) == {"bad.mean", "bad.max"} ^ (
        {"bad.mean", "bad.odd"} if "def ok" in body else set()
    )
    (failure,) = found.failures.itertuples()
    assert "the metric 'bad' is not available" in failure.message and "bug" not in failure.message
    assert any(place in failure.message for place in where) and failure.planner == "constant_speed"
    assert (
        found.exit_code == 3
        and len(found.drives) == 1
        and (found.path / found.drives.iloc[0].files[0]).exists()
    )


def test_a_bug_of_ours_is_called_one(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(trace: object, scenario: object) -> None:
        raise KeyError("lane")

    own = {**METRICS, "speed": replace(METRICS["speed"], measure=wrong)}
    monkeypatch.setattr("replan.run.one_log.METRICS", own)
    found = run(logs / "a.mcap", tmp_path / "out", replace(QUICK, mode="closed"))
    (failure,) = found.failures.itertuples()
    assert "a bug in replan: the metric 'speed' raised: KeyError: 'lane'" in failure.message
    rows = found.metrics[found.metrics["planner"] == "constant_speed"].set_index("metric")
    assert not rows.loc["speed.mean", "available"] and rows.loc["distance.final", "available"]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("def broken(:\n    pass", r"SyntaxError: .*\(refused_\d+\.py:11\)"),
        ("1 / 0", r"ZeroDivisionError: .*\(refused_\d+\.py:11\)"),
        ("raise SystemExit(0)", r"SystemExit: 0 \(refused_\d+\.py:11\)"),
        ("BAD = metric('two words', None)", r"name: one word \(refused_\d+\.py:7\)"),
        ("BAD = metric('bad', None)", r"measure: a function .*\(refused_\d+\.py:7\)"),
        ("BAD = metric('bad', print, ())", r"reductions: at least one.*\(refused_\d+\.py:7\)"),
        ("BAD = metric('gap', print)", "two metrics called 'gap'"),
        ("BAD = 7", "is a int, not a replan.Metric"),
        ("", "no metric in .* is called 'BAD'"),
    ],
)
def test_a_metric_that_cannot_be_loaded_is_refused_before_anything_is_written(
    logs: Path, tmp_path: Path, module: Callable[[str, str], str], body: str, said: str
) -> None:
    name = module(f"refused_{sum(body.encode())}", f"{HEAD}\n{body}\n")
    with pytest.raises(ConfigError, match=said):
        run(logs, tmp_path / "out", replace(QUICK, metrics=(f"{name}:BAD",)))
    assert not (tmp_path / "out").exists()


def test_a_planner_that_raises_in_a_library_is_named_with_its_own_line(
    logs: Path, tmp_path: Path, module: Callable[[str, str], str]
) -> None:
    text = "import numpy as np\nclass P:\n    def __init__(self, context): pass\n"
    name = module(
        "in_a_library",
        text + "    def plan(self, frame):\n        return np.linalg.inv(np.zeros((2, 2)))\n",
    )
    found = run(logs / "a.mcap", tmp_path / "out", replace(QUICK, planners=(f"{name}:P",)))
    assert all(
        "LinAlgError: Singular matrix (in_a_library.py:5)" in one.message
        for one in found.failures.itertuples()
    )
    assert len(found.failures) == 2


def test_addresses_are_not_in_what_is_said() -> None:
    try:
        raise ValueError(f"{object()} is\nodd")
    except ValueError as error:
        assert raised(error).startswith(
            "ValueError: <object object at 0x...> is odd (test_users_code.py:"
        )
