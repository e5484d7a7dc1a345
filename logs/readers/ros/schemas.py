"""Tables of the known message types and of the fields in them.

Sources: the definitions of autoware_msgs (Autoware.AI and Autoware Mini), autoware_perception_msgs,
autoware_auto_perception_msgs, derived_object_msgs and vision_msgs; labels as their constants and
users write them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from replan.logs.agents import AgentKind
from replan.logs.driving import DrivingMode
from replan.logs.rules import Colour

STAMP = ("header.stamp.sec", "header.stamp.nanosec")
POSITION = (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))
CAR, TRUCK, BUS, MOTORCYCLE, BICYCLE, PEDESTRIAN, OBJECT = AgentKind

AUTOWARE_LABELS = {
    1: CAR,
    2: TRUCK,
    3: BUS,
    4: TRUCK,
    5: MOTORCYCLE,
    6: BICYCLE,
    7: PEDESTRIAN,
    8: PEDESTRIAN,
}
"""Kinds by Autoware's label; 8 is an animal, treated as a pedestrian. All others are objects."""
AUTOWARE_NOT_IN_THE_WAY = (10, 11)
"""Labels of objects that do not block the way: OVER_DRIVABLE, UNDER_DRIVABLE."""
DERIVED_LABELS = {4: PEDESTRIAN, 5: BICYCLE, 6: CAR, 7: TRUCK, 8: MOTORCYCLE, 9: CAR}


def twist_fields(path: str) -> tuple[str, ...]:
    """Return the names of the six numbers of a twist or acceleration at a path."""
    return tuple(f"{path}{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")


@dataclass(frozen=True)
class ObjectSchema:
    """Names of the fields of objects in a message type; "": the type has none; `a|b`: the first
    that exists.
    """

    items: str  # list of objects
    # pose; `twist` is the velocity, in the frame `twist_frame`: "object", "frame" or "log" (the
    # data decide)
    pose: str
    twist: str
    id: str  # id of the object
    # Class of the object; if `classes` is a list of classes, `label` and `score` are fields of its
    # items
    label: str
    size: str = ""  # vector of length, width, height; `shape` is 0 box, 1 cylinder, 2 polygon
    twist_frame: str = "object"
    classes: str = ""
    score: str = ""
    shape: str = ""
    outline: str = ""  # points of a polygon in `outline_frame`: "object" or "frame"
    outline_frame: str = "object"
    trusted: str = ""  # flag for whether the velocity is reliable
    solid: str = ""  # shape with a type and a list of dimensions
    # Confidence of the detector, 0 to 1; types without it use the `score` of the class
    existence: str = ""


def _autoware(prefix: str = "kinematics.") -> ObjectSchema:
    return ObjectSchema(
        "objects",
        f"{prefix}pose_with_covariance.pose",
        f"{prefix}twist_with_covariance.twist",
        "object_id.uuid",
        "label",
        "shape.dimensions",
        classes="classification",
        score="probability",
        shape="shape.type",
        outline="shape.footprint.points",
        existence="existence_probability",
    )


_PACKAGES = ("autoware_perception_msgs/msg/", "autoware_auto_perception_msgs/msg/")
OBJECTS = {
    "autoware_msgs/msg/DetectedObjectArray": ObjectSchema(
        "objects",
        "pose",
        "velocity",
        "id",
        "label",
        "dimensions",
        twist_frame="log",
        outline="convex_hull.polygon.points",
        outline_frame="frame",
        trusted="velocity_reliable",
        existence="score",
    ),
    **{f"{p}TrackedObjects": _autoware() for p in _PACKAGES},
    **{f"{p}PredictedObjects": _autoware("kinematics.initial_") for p in _PACKAGES},
    **{f"{p}DetectedObjects": _autoware() for p in _PACKAGES},
    "derived_object_msgs/msg/ObjectArray": ObjectSchema(
        "objects",
        "pose",
        "twist",
        "id",
        "classification",
        twist_frame="log",
        solid="shape",
    ),
    "vision_msgs/msg/Detection3DArray": ObjectSchema(
        "detections",
        "bbox.center",
        "",
        "id|tracking_id",
        "hypothesis.class_id|id",
        "bbox.size",
        classes="results",
        score="hypothesis.score|score",
    ),
}
"""Schemas by message type; `RANK` is the order of preference: tracked before predicted before
detected objects.
"""
RANK = (
    "TrackedObjects",
    "PredictedObjects",
    "ObjectArray",
    "DetectedObjectArray",
    "Detection3DArray",
    "DetectedObjects",
)

TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOMETRY = ("nav_msgs/msg/Odometry",)
POSES = {
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
}
SPEEDS = {
    "autoware_vehicle_msgs/msg/VelocityReport": "longitudinal_velocity",
    "autoware_auto_vehicle_msgs/msg/VelocityReport": "longitudinal_velocity",
    "geometry_msgs/msg/TwistStamped": "twist.linear.x",
    "geometry_msgs/msg/TwistWithCovarianceStamped": "twist.twist.linear.x",
}
ACCELERATIONS = {
    "geometry_msgs/msg/AccelWithCovarianceStamped": "accel.accel.linear.x",
    "geometry_msgs/msg/AccelStamped": "accel.linear.x",
}
STEERING = {
    "autoware_vehicle_msgs/msg/SteeringReport": "steering_tire_angle",
    "autoware_auto_vehicle_msgs/msg/SteeringReport": "steering_tire_angle",
}
COMMANDED_STEERING = {
    "autoware_control_msgs/msg/Control": "lateral.steering_tire_angle",
    "autoware_auto_control_msgs/msg/AckermannControlCommand": "lateral.steering_tire_angle",
}
GOALS = {
    "geometry_msgs/msg/PoseStamped": "pose",
    "autoware_planning_msgs/msg/LaneletRoute": "goal_pose",
    "autoware_auto_planning_msgs/msg/HADMapRoute": "goal_pose",
}
PLANS = ("autoware_planning_msgs/msg/Trajectory", "autoware_auto_planning_msgs/msg/Trajectory")
CLOCK = "rosgraph_msgs/msg/Clock"


@dataclass(frozen=True)
class ModeSchema:
    """How a message type says who drives.

    Attributes:
        fields: The fields that say it.
        modes: The mode by the values of these fields; of other values it is `otherwise`.
        otherwise: The mode of values that are not listed.
        is_latched: Whether the topic is written at changes only; its last value holds.
        names: Ends of the names of topics that are meant, of a type that is used for other things.
    """

    fields: tuple[str, ...]
    modes: Mapping[Any, DrivingMode]
    otherwise: DrivingMode = DrivingMode.UNKNOWN
    is_latched: bool = False
    names: tuple[str, ...] = ()

    def mode(self, values: tuple[object, ...]) -> DrivingMode:
        """The mode of a message with these values."""
        return self.modes.get(values, self.otherwise)


_CONTROL_MODE = ModeSchema(
    ("mode",),
    {
        (1,): DrivingMode.AUTONOMOUS,
        (2,): DrivingMode.STEERED,
        (3,): DrivingMode.PACED,
        (4,): DrivingMode.MANUAL,
        (5,): DrivingMode.GIVEN_UP,
    },
)
_BY_WIRE = {(True,): DrivingMode.AUTONOMOUS, (False,): DrivingMode.MANUAL}
MODES = {
    "autoware_vehicle_msgs/msg/ControlModeReport": _CONTROL_MODE,
    "autoware_auto_vehicle_msgs/msg/ControlModeReport": _CONTROL_MODE,
    "autoware_msgs/msg/VehicleStatus": ModeSchema(
        ("drivemode", "steeringmode"),
        {
            (1, 1): DrivingMode.AUTONOMOUS,
            (0, 1): DrivingMode.STEERED,
            (1, 0): DrivingMode.PACED,
            (0, 0): DrivingMode.MANUAL,
        },
    ),
    "pacmod3_msgs/msg/GlobalRpt": ModeSchema(("enabled",), _BY_WIRE),
    "pacmod_msgs/msg/GlobalRpt": ModeSchema(("enabled",), _BY_WIRE),
    "std_msgs/msg/Bool": ModeSchema(
        ("data",), _BY_WIRE, is_latched=True, names=("/dbw_enabled", "/pacmod/enabled")
    ),
    "autoware_adapi_v1_msgs/msg/OperationModeState": ModeSchema(
        ("is_autoware_control_enabled", "mode"),
        {
            **{(True, mode): DrivingMode.UNKNOWN for mode in (0, 3, 4)},
            **{(True, mode): DrivingMode.AUTONOMOUS for mode in (1, 2)},
        },
        otherwise=DrivingMode.MANUAL,
        is_latched=True,
    ),
}
"""Types of messages that say who drives; a type before another says more."""
PEDALS = {
    "tier4_vehicle_msgs/msg/ActuationStatusStamped": ("status.accel_status", "status.brake_status"),
}
"""Fields of the accelerator's and the brake's positions, 0 to 1."""


@dataclass(frozen=True)
class AlternativesSchema:
    """Names of the fields of candidate trajectories in a message type: the list, the prefix of the
    candidate's fields in an item, its score ("": the type has none).
    """

    items: str
    candidate: str = ""
    score: str = ""


ALTERNATIVES = {
    "autoware_internal_planning_msgs/msg/ScoredCandidateTrajectories": AlternativesSchema(
        "scored_candidate_trajectories", "candidate_trajectory.", "score"
    ),
    "autoware_internal_planning_msgs/msg/CandidateTrajectories": AlternativesSchema(
        "candidate_trajectories"
    ),
}


@dataclass(frozen=True)
class LightSchema:
    """Names of the fields of lights in a message type: the list, the ids in order of preference,
    the list of lamps.
    """

    items: str
    ids: tuple[str, ...]
    lamps: str = ""
    colour: str = "color"
    words: str = ""


LIGHTS = {
    "autoware_msgs/msg/TrafficLightResultArray": LightSchema(
        "results",
        ("light_id", "lane_id"),
        colour="recognition_result",
        words="recognition_result_str",
    ),
    "autoware_perception_msgs/msg/TrafficLightGroupArray": LightSchema(
        "traffic_light_groups", ("traffic_light_group_id",), "elements"
    ),
    "autoware_perception_msgs/msg/TrafficSignalArray": LightSchema(
        "signals", ("traffic_signal_id",), "elements"
    ),
    "autoware_auto_perception_msgs/msg/TrafficSignalArray": LightSchema(
        "signals", ("map_primitive_id",), "lights"
    ),
}
LAMPS = {1: Colour.RED, 2: Colour.YELLOW, 3: Colour.GREEN}
"""Colours by Autoware's number; all others are OFF."""
RESULTS = {0: Colour.RED, 1: Colour.GREEN}
"""Colours by the number in autoware_msgs; UNKNOWN is OFF."""
