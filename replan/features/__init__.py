"""What a network gets of a frame: padded NumPy arrays in one documented form.

    from replan.features import FeatureSizes, features_of
    features = features_of(frame, context)          in `plan` of a planner
    replan export features LOGS -o data/            the same of logs, with the recorded future

`Features` has the shapes, units and frames. It has what PLUTO, PlanTF and Diffusion-Planner read of
a scene: the ego and the agents over the last 2.1 s, static objects, lanes as polylines with limit,
light and place in the route, crosswalks; and the route as one line.
"""

from replan.features.features_of_frame import features_of
from replan.features.form import (
    AGENT_COLUMNS,
    EGO_COLUMNS,
    LANE_COLUMNS,
    LIGHT_CODES,
    OBJECT_COLUMNS,
    ROUTE_COLUMNS,
    SIZE_COLUMNS,
    STEPS,
    VERSION,
    Features,
    FeatureSizes,
)

__all__ = [
    "AGENT_COLUMNS",
    "EGO_COLUMNS",
    "LANE_COLUMNS",
    "LIGHT_CODES",
    "OBJECT_COLUMNS",
    "ROUTE_COLUMNS",
    "SIZE_COLUMNS",
    "STEPS",
    "VERSION",
    "FeatureSizes",
    "Features",
    "features_of",
]
