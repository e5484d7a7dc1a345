"""`replan list`: each name of each table has a line of meaning and a place in the source."""

from importlib.util import find_spec
from pathlib import Path

from replan.cli.listing import KINDS, entries
from replan.draw.charts.layout import CHARTS
from replan.logs.catalogue import FAMILIES, SUITES
from replan.logs.readers import readers
from replan.logs.vehicle import vehicle_names
from replan.metrics import METRICS
from replan.replay.parts import CONTROLLER, PERCEPTION, PLANNER, PREDICTION, TRAFFIC, VEHICLE

ROOT = Path(__file__).parents[3]
TABLES = {
    "planners": PLANNER.builtin,
    "controllers": CONTROLLER.builtin,
    "vehicles": VEHICLE.builtin,
    "cars": vehicle_names(),
    "traffic": TRAFFIC.builtin,
    "predictions": PREDICTION.builtin,
    "perceptions": PERCEPTION.builtin,
    "charts": CHARTS,
    "metrics": METRICS,
    "families": FAMILIES,
    "suites": SUITES,
    "readers": [reader.name for reader in readers()],
}


def test_every_name_of_every_table_is_listed_with_a_line_and_a_place() -> None:
    assert KINDS.keys() == TABLES.keys()
    for kind, names in TABLES.items():
        listed = entries(kind)
        assert [entry.name for entry in listed] == list(names)
        for entry in listed:
            assert entry.says.strip(), entry
            assert "\n" not in entry.says
            module, _, line = entry.where.partition(":")
            if module.endswith(".toml"):
                source = ROOT / module.removeprefix("replan/")
            else:
                source = Path(str(find_spec(module).origin))  # type: ignore[union-attr]
            text = source.read_text(encoding="utf-8").splitlines()
            assert not line or text[int(line) - 1].lstrip().startswith(
                ("def ", "class ", "@", '"', "lambda ")
            ), entry
