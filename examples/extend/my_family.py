"""A family of the catalogue: cars beside the road."""

from replan import Family, Scenario
from replan.logs.catalogue.family_parts import drive, parked, tracks
from replan.logs.catalogue.roads import curve, one_lane


def build(p):
    """Make the scenario with the parameters `p`."""
    path = curve((300.0, 0.0, 0.0))
    ego = drive(path, start=10.0, speed=p["speed_mps"], cruise=p["speed_mps"], duration=5.0)
    others = tracks((parked("near", 40.0, -5.0), parked("far", 200.0, -5.0)))
    return Scenario("", ego, others, one_lane(path, 14.0), 5.0)


PARKED = Family(
    "team/parked",
    "cars beside the road",
    {"speed_mps": 10.0},
    ("parked",),
    build,
    grid={"speed_mps": (8.0, 10.0)},
)
