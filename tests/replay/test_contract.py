"""The checks of contracts: quiet about what keeps its contract, and each rule is named when it is broken alone."""

from __future__ import annotations

from pathlib import Path

import contract_breakers
import pytest

import replan
from logs import ConfigError, Scenario
from logs.catalogue import CATALOGUE
from planners.constant_speed import ConstantSpeed
from replay import contract

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


@pytest.mark.parametrize("planner", ["follower:Follower", "net_planner:Net"])
def test_the_examples_keep_the_contract_of_planners(planner: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    replan.check_planner(planner)
