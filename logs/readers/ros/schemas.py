"""Which message types say what, and where in them: tables, one entry a type.

Sources: the definitions of autoware_msgs (Autoware.AI and Autoware Mini), autoware_perception_msgs,
autoware_auto_perception_msgs, derived_object_msgs and vision_msgs; labels as their constants and users write them.
"""

from __future__ import annotations

from dataclasses import dataclass

from logs.agents import AgentKind
from logs.rules import Colour

STAMP = ("header.stamp.sec", "header.stamp.nanosec")
CAR, TRUCK, BUS = AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS
MOTORCYCLE, BICYCLE, PEDESTRIAN = AgentKind.MOTORCYCLE, AgentKind.BICYCLE, AgentKind.PEDESTRIAN
OBJECT = AgentKind.OBJECT

AUTOWARE_LABELS = {
    1: CAR, 2: TRUCK, 3: BUS, 4: TRUCK, 5: MOTORCYCLE, 6: BICYCLE, 7: PEDESTRIAN, 8: PEDESTRIAN,
}  # fmt: skip
"""8 is an animal: it walks. All others are objects."""
AUTOWARE_NOT_IN_THE_WAY = (10, 11)
"""OVER_DRIVABLE, UNDER_DRIVABLE."""
DERIVED_LABELS = {4: PEDESTRIAN, 5: BICYCLE, 6: CAR, 7: TRUCK, 8: MOTORCYCLE, 9: CAR}
WORDS = (
    ("motor", MOTORCYCLE), ("scooter", MOTORCYCLE), ("cycl", BICYCLE), ("bike", BICYCLE), ("rider", BICYCLE),
    ("pedestrian", PEDESTRIAN), ("person", PEDESTRIAN), ("human", PEDESTRIAN), ("people", PEDESTRIAN),
    ("child", PEDESTRIAN), ("stroller", PEDESTRIAN), ("wheelchair", PEDESTRIAN), ("animal", PEDESTRIAN),
    ("truck", TRUCK), ("lorry", TRUCK), ("trailer", TRUCK), ("construction_vehicle", TRUCK), ("bus", BUS),
    ("tram", BUS), ("train", BUS), ("car", CAR), ("van", CAR), ("taxi", CAR), ("vehicle", CAR),
)  # fmt: skip
"""A label has the kind of the first word that it contains; labels with none of the words are objects."""
NO_CARS = ("cart", "cardboard", "carton")


def kind_of_word(label: str) -> AgentKind:
    """The kind that a label in words means; OBJECT if no word is known."""
    text = label.lower()
    if any(word in text for word in NO_CARS):
        return OBJECT
    return next((kind for word, kind in WORDS if word in text), OBJECT)


@dataclass(frozen=True)
class ObjectSchema:
    """Where a message type has its objects; a field named "" is not there, `a|b` is the first that there is.

    Attributes:
        items: The list of objects, `frame` the frame that holds for all of them; `own_frame` that of one.
        pose: Pose; `twist` velocity, in the frame `twist_frame`: "object", "frame" or "log" (the data decide).
        size: Vector of length, width, height; `shape` 0 box, 1 cylinder, 2 polygon.
        outline: Points of a polygon; `outline_frame` "object" or "frame".
        label: The field, or the list of classes (`classes`, with `label` and `score` within).
        trusted: A flag that says whether the velocity is meant.
        existence: How sure the detector is of the object, 0 to 1; where the type has none, the `score` of its class.
    """

    items: str
    pose: str
    twist: str
    id: str
    label: str
    size: str = ""
    twist_frame: str = "object"
    classes: str = ""
    score: str = ""
    shape: str = ""
    outline: str = ""
    outline_frame: str = "object"
    trusted: str = ""
    solid: str = ""
    existence: str = ""


def _autoware(kinematics: str, prefix: str = "") -> ObjectSchema:
    return ObjectSchema(
        "objects", f"{kinematics}{prefix}pose_with_covariance.pose", f"{kinematics}{prefix}twist_with_covariance.twist",
        "object_id.uuid", "label", "shape.dimensions", classes="classification", score="probability",
        shape="shape.type", outline="shape.footprint.points", existence="existence_probability",
    )  # fmt: skip


_PACKAGES = ("autoware_perception_msgs/msg/", "autoware_auto_perception_msgs/msg/")
OBJECTS = {
    "autoware_msgs/msg/DetectedObjectArray": ObjectSchema(
        "objects", "pose", "velocity", "id", "label", "dimensions", twist_frame="log",
        outline="convex_hull.polygon.points", outline_frame="frame", trusted="velocity_reliable", existence="score",
    ),
    **{f"{p}TrackedObjects": _autoware("kinematics.") for p in _PACKAGES},
    **{f"{p}PredictedObjects": _autoware("kinematics.", "initial_") for p in _PACKAGES},
    **{f"{p}DetectedObjects": _autoware("kinematics.") for p in _PACKAGES},
    "derived_object_msgs/msg/ObjectArray": ObjectSchema(
        "objects", "pose", "twist", "id", "classification", twist_frame="log", solid="shape",
    ),
    "vision_msgs/msg/Detection3DArray": ObjectSchema(
        "detections", "bbox.center", "", "id|tracking_id", "hypothesis.class_id|id", "bbox.size", classes="results",
        score="hypothesis.score|score",
    ),
}  # fmt: skip
"""In order of preference: what is tracked before what is predicted before what is detected."""
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
    "geometry_msgs/msg/PoseStamped": "pose", "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
}  # fmt: skip
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
class LightSchema:
    """Where a message type has its lights: the list, the ids in order of preference, and the list of lamps in each."""

    items: str
    ids: tuple[str, ...]
    lamps: str = ""
    colour: str = "color"
    words: str = ""


LIGHTS = {
    "autoware_msgs/msg/TrafficLightResultArray": LightSchema(
        "results", ("light_id", "lane_id"), colour="recognition_result", words="recognition_result_str"
    ),
    "autoware_perception_msgs/msg/TrafficLightGroupArray": LightSchema(
        "traffic_light_groups", ("traffic_light_group_id",), "elements"
    ),
    "autoware_perception_msgs/msg/TrafficSignalArray": LightSchema("signals", ("traffic_signal_id",), "elements"),
    "autoware_auto_perception_msgs/msg/TrafficSignalArray": LightSchema("signals", ("map_primitive_id",), "lights"),
}
LAMPS = {1: Colour.RED, 2: Colour.YELLOW, 3: Colour.GREEN}
"""Of Autoware; all others are OFF."""
RESULTS = {0: Colour.RED, 1: Colour.GREEN}
"""Of autoware_msgs; UNKNOWN is OFF."""
