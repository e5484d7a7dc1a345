"""The checks of contracts: quiet about what keeps its contract, and each rule is named when it is
broken alone.
"""

from dataclasses import replace
from pathlib import Path

import contract_breakers
import pytest

import replan
from replan import contract
from replan.contract.reader_rules import MOST_DAMAGED
from replan.core.errors import ConfigError
from replan.logs.catalogue import CATALOGUE
from replan.logs.edit.cut import cut
from replan.logs.readers import LogSettings, reader_of
from replan.logs.scenario import Scenario
from replan.metrics import METRICS
from replan.planners.constant_speed import ConstantSpeed

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def few() -> list[Scenario]:
    return [CATALOGUE["everyday/cut_in"].scenario()]


@pytest.mark.parametrize("rule", contract.PLANNER_RULES)
def test_a_planner_that_breaks_a_rule_is_found_by_it_alone(rule: str, few: list[Scenario]) -> None:
    with pytest.raises(replan.ContractError) as found:
        replan.check_planner(contract_breakers.PLANNERS[rule], scenarios=few)
    assert found.value.broken == (rule,)


def test_a_planner_is_named_a_class_or_a_function(few: list[Scenario]) -> None:
    for planner in ("constant_speed", ConstantSpeed, lambda context: ConstantSpeed(context)):
        replan.check_planner(planner, scenarios=few)
    with pytest.raises(replan.ContractError) as found:
        replan.check_planner("contract_breakers:Start", scenarios=few)
    assert found.value.broken == ("start",)
    for spec in ("constant_sped", "exec:./planner"):
        with pytest.raises(ConfigError):
            replan.check_planner(spec)


def test_a_planner_with_the_past_of_its_frames_has_no_memory(few: list[Scenario]) -> None:
    replan.check_planner(contract_breakers.ReadsPast, scenarios=[*few, cut(few[0], 3.0)])


@pytest.mark.parametrize(
    ("planner", "rule"),
    [
        (contract_breakers.RemembersAgents, "memory"),
        (contract_breakers.ReadsPastUnasked, "answer"),
    ],
)
def test_a_past_that_is_kept_or_not_asked_for_breaks_a_rule(
    planner: type[ConstantSpeed], rule: str, few: list[Scenario]
) -> None:
    with pytest.raises(replan.ContractError) as found:
        replan.check_planner(planner, scenarios=few)
    assert found.value.broken == (rule,)


@pytest.mark.parametrize("planner", ["follower:Follower", "net_planner:Net"])
def test_the_examples_keep_the_contract_of_planners(
    planner: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    replan.check_planner(planner)


@pytest.mark.parametrize("rule", contract.METRIC_RULES)
def test_a_metric_that_breaks_a_rule_is_found_by_it_alone(rule: str, few: list[Scenario]) -> None:
    with pytest.raises(replan.ContractError) as found:
        replan.check_metric(contract_breakers.METRICS[rule], scenarios=few)
    assert found.value.broken == (rule,)


def test_built_in_metrics_keep_their_contract(few: list[Scenario]) -> None:
    logs = (*few, CATALOGUE["everyday/traffic_light"].scenario())
    drives = contract.metric_rules.metric_drives([cut(log, 0.0, 4.0) for log in logs])
    for metric in (*METRICS.values(), contract_breakers.GOOD):
        contract.metric_rules.check_metric_on(metric, drives)


def test_the_example_keeps_the_contract_of_metrics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    replan.check_metric("passing_speed:passing_speed")


@pytest.fixture
def txy(tmp_path: Path) -> Path:
    path = tmp_path / "drive.txy"
    path.write_text(
        "".join(f"{0.1 * k:.1f} {k:.1f} 0.0 0.0\n" for k in range(30)), encoding="utf-8"
    )
    return path


@pytest.mark.parametrize("rule", contract.READER_RULES)
def test_a_reader_that_breaks_a_rule_is_found_by_it_alone(rule: str, txy: Path) -> None:
    with pytest.raises(replan.ContractError) as found:
        replan.check_reader(contract_breakers.READERS[rule], txy)
    assert found.value.broken == (rule,)


def test_a_reader_that_raises_when_its_files_are_asked_again_breaks_a_rule(txy: Path) -> None:
    answers = iter([(txy,)])
    reader = replace(contract_breakers.TXY, files=lambda path: next(answers))
    with pytest.raises(replan.ContractError) as found:
        replan.check_reader(reader, txy)
    assert "files" in found.value.broken


def test_of_a_log_of_many_files_eight_are_damaged_in_turn(txy: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.mkdir()
    content = txy.read_bytes()
    for number in range(2 * MOST_DAMAGED - 1):
        (log / f"{number:02}.txy").write_bytes(content)
    damaged = set[str]()

    def read(path: Path, settings: LogSettings) -> Scenario:
        damaged.update(file.name for file in path.iterdir() if file.stat().st_size < len(content))
        return contract_breakers.TXY.read(path / "00.txy", settings)

    reader = replace(
        contract_breakers.TXY,
        claims=lambda path: (path / "00.txy").is_file(),
        files=lambda path: tuple(sorted(path.iterdir())),
        read=read,
    )
    replan.check_reader(reader, log)
    assert len(damaged) == MOST_DAMAGED


def test_a_reader_is_named_or_an_object(txy: Path) -> None:
    replan.check_reader("contract_breakers:TXY", txy)
    replan.check_reader(contract_breakers.TXY, str(txy))


def test_the_readers_of_our_own_logs_and_of_tables_keep_their_contract(
    tmp_path: Path, few: list[Scenario]
) -> None:
    replan.write_log(tmp_path / "drive.mcap", few[0])
    rows = ["t,x,y,yaw,v", *(f"{0.1 * k:.1f},{k:.1f},0.0,0.0,10.0" for k in range(30))]
    (tmp_path / "table").mkdir()
    (tmp_path / "table" / "ego.csv").write_text("\n".join(rows), encoding="utf-8")
    for name in ("drive.mcap", "table"):
        reader = reader_of(tmp_path / name)
        assert reader is not None
        replan.check_reader(reader, tmp_path / name)


RECORDED = {
    "osi/alks_cut-in.osi": LogSettings(ego="0"),
    "commonroad/ZAM_Tutorial-1_1_T-1.xml": LogSettings(),
    "commonroad/USA_Peach-3_1_T-1.xml": LogSettings(),
    "comma2k19/segment_40": LogSettings(),
    "tartu/ros1/pedestrian_crossing_09.bag": LogSettings(),
    "tartu/ros2/pedestrian_crossing_09": LogSettings(),
    "argoverse2/3b3570b4-7b0b-3268-a571-b0889dbf40b6": LogSettings(),
    "py123d/madeup/logs/madeup_train/signalled_crossing_001": LogSettings(),
}


@pytest.mark.parametrize("log", RECORDED)
def test_built_in_readers_keep_their_contract(log: str, shared_data: Path) -> None:
    reader = reader_of(shared_data / log, RECORDED[log])
    assert reader is not None
    replan.check_reader(reader, shared_data / log, RECORDED[log])
