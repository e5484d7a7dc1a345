"""Whatever is chosen by name may be a user's: examples/extend is run as it stands, and by entry
points.
"""

import runpy
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import command_line
import pytest

import replan
from replan import metrics
from replan.config import RunConfig, dump_run, load_run
from replan.core.errors import ConfigError, PlannerError
from replan.core.extension import ExtensionKind
from replan.draw.charts.layout import CHART
from replan.logs import readers
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import OF_LOOP, PLANNER
from replan.run import evaluate_logs
from replan.run.checks import checked

ROOT = Path(__file__).parents[2]
OWN = {
    "vehicle": "my_vehicle:Late",
    "controller": "my_controller:Proportional",
    "traffic": "my_traffic:Without",
    "prediction": "my_prediction:stopping",
    "perception": "my_perception:ahead",
}
NAMES = {
    "vehicles": ("late", "my_vehicle:Late"),
    "controllers": ("proportional", "my_controller:Proportional"),
    "traffic": ("without", "my_traffic:Without"),
    "predictions": ("stopping", "my_prediction:stopping"),
    "perceptions": ("ahead", "my_perception:ahead"),
    "planners": ("held", "my_planner:Held"),
    "metrics": ("width", "my_metric:WIDTH"),
    "readers": ("txy", "my_reader:READER"),
    "charts": ("my_speed", "my_chart:speed"),
    "families": ("team/parked", "my_family:PARKED"),
}
"""By the group of entry points: a name, and what it stands for."""
MY_PLANNER = """
from replan.planners.constant_speed import ConstantSpeed


class Held(ConstantSpeed):
    '''Mine.'''
"""
METRIC = """
from replan.metrics.reductions import MAX
from replan import Metric, Mode, Series


def width(trace, scenario):
    return Series(trace.ego.t, 0.0 * trace.ego.t + scenario.vehicle.width)


WIDTH = Metric("width", "m", "none", (Mode.CLOSED,), width, (MAX,), "For a test.")
"""
MORE = {"my_planner.py": MY_PLANNER, "my_metric.py": METRIC}


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A user's folder, outside of the repository, with the examples."""
    shutil.copy(ROOT / "examples" / "electric_car.py", tmp_path)
    shutil.copytree(ROOT / "examples" / "extend", tmp_path, dirs_exist_ok=True)
    for name, text in MORE.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    known = set(sys.modules)
    yield tmp_path
    readers.readers.cache_clear()
    for name in set(sys.modules) - known:
        if name.startswith(("my_", "electric_")):
            del sys.modules[name]


def installed(desk: Path) -> None:
    """The user's modules as a distribution with entry points."""
    card = desk / "site" / "team-1.0.dist-info"
    card.mkdir(parents=True)
    for file in desk.glob("my_*.py"):
        shutil.move(file, desk / "site" / file.name)
    groups = "".join(
        f"[replan.{group}]\n{name} = {place}\n" for group, (name, place) in NAMES.items()
    )
    (card / "entry_points.txt").write_text(groups, encoding="utf-8")
    (card / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: team\nVersion: 1.0\n", encoding="utf-8"
    )
    sys.path.append(str(desk / "site"))
    readers.readers.cache_clear()


def test_the_parts_of_the_page_drive_and_are_in_the_results(desk: Path) -> None:
    config = load_run(Path("run.toml"))
    result = replan.evaluate(
        suite="my_family:PARKED",
        config=config,
        out="out",
        mode="closed",
        internals="none",
        recording=False,
        loop=OWN,
    )
    assert list(result.failures["message"]) == []
    assert list(result.logs["log"]) == ["team/parked@speed_mps=8", "team/parked@speed_mps=10"]
    assert set(result.drives["end"]) == {"goal reached"}
    run = load_run(Path("out/run.toml"))
    assert run.vehicle_model == {OWN["vehicle"]: {"delay_s": 0.02}}  # as set
    assert run.controller == {OWN["controller"]: {"gain": 0.05}}
    assert run.prediction == {OWN["prediction"]: {"decel_mps2": 2.0}}  # by default
    assert run.perception == {OWN["perception"]: {"range_m": 50.0}} and run.traffic == {
        OWN["traffic"]: {"who": "near"}
    }
    lateral = result.metrics.query("metric == 'tracking_lateral.max_abs' and mode == 'closed'")[
        "value"
    ]
    assert (lateral < 0.2).all()
    drawn = command_line.replan("plot", "out", "--chart", "my_chart:speed", "-o", "speed.svg")
    assert drawn.exit_code == 0 and "My speed" in Path("speed.svg").read_text(encoding="utf-8")
    done = command_line.replan("report", "out")
    assert done.exit_code == 0 and "My speed" in Path("out/report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_vehicle_from_scratch_is_driven_by_every_kind_of_controller(desk: Path) -> None:
    for controller in ("dlqr_pid", "mpc", "pid", OWN["controller"]):
        loop = {"vehicle": "electric_car:Electric", "controller": controller}
        result = replan.evaluate(
            suite="my_family:PARKED",
            planners=["constant_speed"],
            out=f"out-{controller[:4]}",
            mode="closed",
            internals="none",
            recording=False,
            loop=loop,
        )
        assert list(result.failures["message"]) == [], controller
        assert set(result.drives["end"]) == {"goal reached"}, controller
        lateral = result.metrics.query("metric == 'tracking_lateral.max_abs' and mode == 'closed'")[
            "value"
        ]
        assert (lateral < 0.2).all(), controller


def test_a_reader_named_in_the_settings_reads_first(desk: Path) -> None:
    runpy.run_path("write_txy.py")
    done = command_line.replan("convert", "my_reader:READER", "drive.txy", "-o", "drive.mcap")
    assert done.exit_code == 0, done.output
    Path("log.toml").write_text('[log]\nreader = "my_reader:READER"\n', encoding="utf-8")
    done = command_line.replan("inspect", "drive.txy", "--config", "log.toml")
    assert done.exit_code == 0 and "t x y yaw, a line each" in done.output
    ego = replan.read_log(Path("drive.mcap")).ego
    assert ego.x[-1] - ego.x[0] == pytest.approx(29.0)


@pytest.mark.slow
def test_installed_packages_give_names(desk: Path) -> None:
    installed(desk)
    loop = {key: NAMES[kind.plural][0] for key, kind in OF_LOOP.items()}
    result = replan.evaluate(
        suite="team/parked",
        planners="held",
        metrics=["width"],
        out="out",
        mode="closed",
        internals="none",
        recording=False,
        loop=loop,
    )
    assert list(result.failures["message"]) == [] and set(result.drives["planner"]) == {"held"}
    assert "width.max" in set(result.metrics["metric"])
    for group, (name, _) in NAMES.items():
        listed = command_line.replan("list", group)
        assert f"{name}: " in listed.output, listed.output


@pytest.mark.slow
def test_the_command_line_and_its_workers_find_them(desk: Path) -> None:
    script = "from replan.cli import main\nif __name__ == '__main__':\n    main()\n"
    Path("call.py").write_text(script, encoding="utf-8")
    words = [
        "evaluate",
        "--suite",
        "my_family:PARKED",
        "--config",
        "run.toml",
        "-p",
        "my_planner:Held",
        "--mode",
        "closed",
    ]
    words += [
        "--metric",
        "my_metric:WIDTH",
        *(word for key, name in OWN.items() for word in (f"--{key}", name)),
    ]
    command = [
        sys.executable,
        "-P",
        "call.py",
        *words,
        "--workers",
        "2",
        "--no-recording",
        "-o",
        "out",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1, 4), done.stderr
    assert replan.load("out").failures.empty


# --- wrong names and settings, before anything is driven


def loop(**names: str) -> RunConfig:
    return RunConfig(("constant_speed",), loop=LoopConfig(**names))


@pytest.mark.parametrize("key", OF_LOOP)
def test_a_wrong_name_says_the_nearest(desk: Path, key: str) -> None:
    kind = OF_LOOP[key]
    module, _, name = OWN[key].partition(":")
    for spec, said in (
        (name[:-1], "no .* is called .*module:NAME"),
        (f"{module}:{name}s", f"no {key} in {module} is called .*did you mean '{name}'"),
        (f"{module}:", "write it as module:NAME"),
        ("my_nothing:X", "No module named 'my_nothing'.*PYTHONPATH"),
        (next(iter(kind.builtin))[:-1], "did you mean"),
    ):
        with pytest.raises(ConfigError, match=f"^loop.{key}: .*{said}"):
            checked(loop(**{key: spec}))


@pytest.mark.parametrize("key", OF_LOOP)
def test_a_wrong_setting_is_refused_and_names_its_key(desk: Path, key: str) -> None:
    table, own = OF_LOOP[key].table, OWN[key]
    with pytest.raises(ConfigError, match=rf'{table}\."{own}"\.gian'):
        checked(
            RunConfig(
                ("constant_speed",), loop=LoopConfig(**{key: own}), **{table: {own: {"gian": 1.0}}}
            )
        )
    with pytest.raises(ConfigError, match=r"no .* is called 'unknown'"):
        checked(RunConfig(("constant_speed",), **{table: {"unknown": {}}}))
    Path("my_needy.py").write_text("def needy(*given, must): ...\n", encoding="utf-8")
    with pytest.raises(
        ConfigError, match=f"{key} 'my_needy:needy' cannot be built: missing .* argument: 'must'"
    ):
        checked(loop(**{key: "my_needy:needy"}))


ALL = (PLANNER, metrics.METRIC, readers.READER, CHART, *OF_LOOP.values())


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.name)
def test_an_import_that_fails_names_the_module_and_the_line(
    desk: Path, kind: ExtensionKind[object]
) -> None:
    Path("my_helper.py").write_text("\n\nimport torchy.nn\n", encoding="utf-8")
    Path("my_package").mkdir()
    Path("my_package", "__init__.py").write_text(
        "from my_package.part import x\n", encoding="utf-8"
    )
    for k, (text, said, remedy) in enumerate(
        (
            (
                "import os\nimport torchy",
                "No module named 'torchy' (my_0.py:2)",
                "install 'torchy'",
            ),
            ("import my_helper", "No module named 'torchy' (my_helper.py:3)", "install 'torchy'"),
            ("import my_package", "No module named 'my_package.part' (__init__.py:1)", ""),
            ("from numpy import nix", "cannot import name 'nix' from 'numpy'", ""),
            (
                "import planners.base",
                "it is 'replan.planners' now",
                "(from replan import Plan, Trajectory)",
            ),
        )
    ):
        Path(f"my_{k}.py").write_text(f"{text}\n", encoding="utf-8")
        with pytest.raises(kind.error) as error:
            kind.find(f"my_{k}:X")
        line = str(error.value)
        assert (
            line.startswith(f"{kind.name} 'my_{k}:X' cannot be loaded: ")
            and said in line
            and remedy in line
        )
        assert ("install '" in line) == remedy.startswith("install"), line


def test_a_module_that_is_not_found_lists_the_places_tried_in_their_order(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(desk / "first"))
    with pytest.raises(PlannerError) as error:
        PLANNER.find("nowhere.mine:Mine")
    line = str(error.value)
    assert (
        line.index(f" in {desk / 'first'}, ")
        < line.index("site-packages")
        < line.index(f", {desk};")
    )
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry != str(ROOT)])
    with pytest.raises(PlannerError, match=r"No module named 'planners' in .*site-packages"):
        PLANNER.find("planners.of_another_folder:Mine")
    Path("somewhere").mkdir()
    Path("somewhere", "__init__.py").touch()
    with pytest.raises(
        PlannerError, match=f"No module named 'somewhere.mine' in {desk / 'somewhere'};"
    ):
        PLANNER.find("somewhere.mine:Mine")


def test_a_part_without_a_member_of_its_protocol_is_refused(desk: Path) -> None:
    Path("my_half.py").write_text(
        "class Half:\n    def __init__(self, *given): ...\n", encoding="utf-8"
    )
    for key, lacks in (("controller", "notes"), ("vehicle", "state")):
        with pytest.raises(
            ConfigError, match=f"{key} 'my_half:Half': it built a Half without {lacks}"
        ):
            checked(loop(**{key: "my_half:Half"}))


def test_settings_of_built_in_ones_are_their_configuration() -> None:
    run = RunConfig(
        ("idm",),
        loop=LoopConfig(controller="mpc", vehicle="single_track"),
        controller={"mpc": {"steps": 9}},
    )
    found, _ = checked(run)
    assert found.controller["mpc"]["steps"] == 9 and found.controller["mpc"]["step_s"] == 0.1
    assert found.vehicle_model["single_track"]["tyre"] == "pacejka"
    assert found.drive_loop.settings["controller"] == found.controller["mpc"]
    with pytest.raises(ConfigError, match=r"controller\.mpc\.steps: expected int"):
        checked(RunConfig(("idm",), controller={"mpc": {"steps": 1.5}}))


def test_the_resolved_run_is_read_back_to_the_same(desk: Path) -> None:
    found, _ = checked(RunConfig(("constant_speed",), loop=LoopConfig(**OWN)))
    Path("again.toml").write_text(dump_run(found), encoding="utf-8")
    again = load_run(Path("again.toml"))
    assert {**vars(again), "gates": ""} == {**vars(found), "gates": ""}
    assert checked(again)[0] == again


def test_resume_refuses_where_a_setting_or_the_source_has_changed(desk: Path) -> None:
    run = RunConfig(
        ("constant_speed",),
        "open",
        recording=False,
        internals="none",
        loop=LoopConfig(prediction=OWN["prediction"]),
    )
    evaluate_logs((), run, "out", suite="my_family:PARKED")
    assert evaluate_logs((), run, "out", suite="my_family:PARKED", resume=True).resumed == 2
    other = RunConfig(**{**vars(run), "prediction": {OWN["prediction"]: {"decel_mps2": 3.0}}})
    with pytest.raises(ConfigError, match=r"prediction.*decel_mps2 was 2.0, is 3.0"):
        evaluate_logs((), other, "out", suite="my_family:PARKED", resume=True)
    module = Path("my_prediction.py")
    module.write_text(f"{module.read_text(encoding='utf-8')}# changed\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="other code"):
        evaluate_logs((), run, "out", suite="my_family:PARKED", resume=True)


@pytest.mark.parametrize("raises", ["RuntimeError('lazy')", "SystemExit(7)", "KeyboardInterrupt"])
def test_whatever_a_module_raises_is_an_error_of_loading_it(
    desk: Path, monkeypatch: pytest.MonkeyPatch, raises: str
) -> None:
    """Also as its attributes are read; KeyboardInterrupt only where a signal raises another one."""
    Path("my_lazy.py").write_text(f"def __getattr__(name):\n    raise {raises}\n", encoding="utf-8")
    monkeypatch.setattr("replan.core.extension.signal.getsignal", lambda number: None)
    kind: ExtensionKind[object] = ExtensionKind("thing", "things", {})
    with pytest.raises(ConfigError, match=r"thing 'my_lazy:mine' cannot be loaded: .*my_lazy.py:2"):
        kind.find("my_lazy:mine")


def test_two_of_one_name_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    from importlib.metadata import EntryPoint

    kind: ExtensionKind[object] = ExtensionKind("thing", "things", {"a": print})
    twice = tuple(EntryPoint("b", value, kind.group) for value in ("x:B", "y:B"))
    for entries in (twice, (EntryPoint("a", "x:A", kind.group),)):
        monkeypatch.setattr(
            "replan.core.extension._installed_entry_points",
            lambda group, path, found=entries: found,
        )
        with pytest.raises(ConfigError, match="there are two things called"):
            kind.find("b")


def test_imported_names_are_not_offered_as_a_modules_own(desk: Path) -> None:
    text = "from math import sin\nfrom pathlib import Path\n\ndef mine(): ...\nclass Mine: ...\n"
    Path("my_things.py").write_text(text, encoding="utf-8")
    Path("my_list.py").write_text(
        "from my_things import mine, Mine\n__all__ = ['mine']\n", encoding="utf-8"
    )
    kind: ExtensionKind[object] = ExtensionKind("thing", "things", {})
    for module, known in (("my_things", "Mine, mine"), ("my_list", "mine")):
        with pytest.raises(ConfigError, match=f"known are: {known}$"):
            kind.find(f"{module}:zzz")


# --- charts and panels that would not be seen


def test_a_chart_or_panel_without_a_place_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy as np

    from replan.draw.charts import layout
    from replan.draw.panels import Panel
    from replan.draw.recording.plots import RecordingContents, blueprint

    monkeypatch.setitem(layout.CHARTS, "extra", lambda subject: [])
    with pytest.raises(ValueError, match="the chart 'extra' has no place in LAYOUT"):
        layout.placed(None)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="the panel 'extra' is in no row of ROWS"):
        blueprint(RecordingContents([Panel("extra", "", (), 1.0)], (), 0, (), np.zeros((2, 2))))


@pytest.mark.parametrize(
    ("body", "said"),
    [("return 1 / 0", "ZeroDivisionError"), ("return 7", "int instead of a Chart")],
)
def test_a_chart_that_fails_says_why_in_its_place(desk: Path, body: str, said: str) -> None:
    from replan.draw.charts.layout import drawn

    Path(f"my_bad_{len(body)}.py").write_text(f"def bad(subject):\n    {body}\n", encoding="utf-8")
    (chart,) = drawn(None, f"my_bad_{len(body)}:bad")  # type: ignore[arg-type]
    assert said in chart.says and "my_bad" in chart.body


GAINS = """def it(*_, gain: float = 1.0):
    if gain < 0:
        raise ValueError("below")
    return {}[gain]
"""


@pytest.mark.parametrize("key", OF_LOOP)
def test_parts_that_cannot_be_built_are_named_before_the_first_drive(desk: Path, key: str) -> None:
    """With its settings.

    And with none, where it is built without a log, which may be what it lacks.
    """
    Path("my_gains.py").write_text(GAINS, encoding="utf-8")
    name = "my_gains:it"
    refused = rf"{key} '{name}' cannot be built: (ValueError|KeyError): .*\(my_gains\.py:"
    with pytest.raises(ConfigError, match=f"{refused}3"):
        checked(replace(loop(**{key: name}), **{OF_LOOP[key].table: {name: {"gain": -1.0}}}))
    if key in ("vehicle", "controller"):
        with pytest.raises(ConfigError, match=f"{refused}4"):
            checked(loop(**{key: name}))
    else:
        run, failures = checked(loop(**{key: name}))
        assert getattr(run.loop, key) == name and not failures
