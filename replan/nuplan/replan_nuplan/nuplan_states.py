"""Ego, objects and lights of a message as objects of the devkit.

Vectors of the ego are in its own frame, those of objects in the world's. Headings are in [-pi, pi).
nuPlan has one class for vehicles, and counts motorcycles among bicycles; objects that are no road
users are static. Times are microseconds since the epoch, at least `EARLIEST_US`, since the devkit
refuses negative ones and the past begins before t = 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from nuplan.common.actor_state.agent import Agent
from nuplan.common.actor_state.ego_state import EgoState
from nuplan.common.actor_state.oriented_box import OrientedBox
from nuplan.common.actor_state.scene_object import SceneObjectMetadata
from nuplan.common.actor_state.state_representation import StateSE2, StateVector2D, TimePoint
from nuplan.common.actor_state.static_object import StaticObject
from nuplan.common.actor_state.tracked_objects import TrackedObjects
from nuplan.common.actor_state.tracked_objects_types import TrackedObjectType
from nuplan.common.actor_state.vehicle_parameters import VehicleParameters
from nuplan.common.maps.maps_datatypes import TrafficLightStatusData, TrafficLightStatusType
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks

from .nuplan_channel import Message, column

EARLIEST_US = 10_000_000
HEIGHT_M = 1.7
TYPES = {
    "car": TrackedObjectType.VEHICLE,
    "truck": TrackedObjectType.VEHICLE,
    "bus": TrackedObjectType.VEHICLE,
    "motorcycle": TrackedObjectType.BICYCLE,
    "bicycle": TrackedObjectType.BICYCLE,
    "pedestrian": TrackedObjectType.PEDESTRIAN,
    "object": TrackedObjectType.GENERIC_OBJECT,
    "cone": TrackedObjectType.TRAFFIC_CONE,
    "barrier": TrackedObjectType.BARRIER,
    "sign": TrackedObjectType.CZONE_SIGN,
}
"""Types by kind, and by class of object."""
COLOURS = {
    "green": TrafficLightStatusType.GREEN,
    "yellow": TrafficLightStatusType.YELLOW,
    "red": TrafficLightStatusType.RED,
    "red and yellow": TrafficLightStatusType.RED,
}
"""A light that is off is left out."""


def wrapped(angle: float) -> float:
    """An angle in [-pi, pi)."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


class Converter:
    """Converts the messages of one drive; `context`: `hello.context`."""

    def __init__(self, context: Message, numbers: dict[int, int]) -> None:
        car = context["vehicle"]
        self._start_us = max(int(context.get("start_ns", 0) // 1000), EARLIEST_US)
        self._numbers, self._light_lanes = numbers, context["light_lanes"]
        self.vehicle = VehicleParameters(
            width=car["width"],
            front_length=car["length"] - car["rear_overhang"],
            rear_length=car["rear_overhang"],
            cog_position_from_rear_axle=0.5 * car["wheelbase"],
            wheel_base=car["wheelbase"],
            vehicle_name="ego",
            vehicle_type="car",
            height=HEIGHT_M,
        )

    def time(self, t: float) -> TimePoint:
        """A time since the start, s."""
        return TimePoint(self._start_us + round(1e6 * t))

    def seconds(self, time: TimePoint) -> float:
        """The inverse of `time`."""
        return (time.time_us - self._start_us) / 1e6

    def ego(self, state: Message) -> EgoState:
        """The ego's state; its lateral acceleration is that of its path."""
        return EgoState.build_from_rear_axle(
            rear_axle_pose=StateSE2(state["x"], state["y"], wrapped(state["yaw"])),
            rear_axle_velocity_2d=StateVector2D(state["v"], state["v_lat"]),
            rear_axle_acceleration_2d=StateVector2D(
                state["a"], state["v"] * state["v"] * state["kappa"]
            ),
            tire_steering_angle=state["steer"],
            time_point=self.time(state["t"]),
            vehicle_parameters=self.vehicle,
            angular_vel=state["yaw_rate"],
        )

    def observation(self, t: float, agents: Message, classes: dict[str, str]) -> DetectionsTracks:
        """The objects at a time; `classes` of objects, by id."""
        names = ("length", "width", "x", "y", "yaw", "vx", "vy")
        columns = [column(agents[name]).tolist() for name in names]
        time_us = self.time(t).time_us
        tracked: list[Any] = []
        for row, (name, kind) in enumerate(zip(agents["ids"], agents["kinds"])):
            length, width, x, y, yaw, vx, vy = (values[row] for values in columns)
            metadata = SceneObjectMetadata(time_us, f"{name}@{time_us}", row, name, kind)
            shape = OrientedBox(StateSE2(x, y, wrapped(yaw)), length, width, HEIGHT_M)
            if kind == "object":
                tracked.append(StaticObject(TYPES[classes.get(name, kind)], shape, metadata))
            else:
                tracked.append(Agent(TYPES[kind], shape, StateVector2D(vx, vy), metadata))
        return DetectionsTracks(TrackedObjects(tracked))

    def lights(self, t: float, lights: list[Message]) -> list[TrafficLightStatusData]:
        """One entry for each lane that a light controls."""
        time_us = self.time(t).time_us
        return [
            TrafficLightStatusData(COLOURS[light["colour"]], self._numbers[lane], time_us)
            for light in lights
            if light["colour"] in COLOURS
            for lane in self._light_lanes.get(light["id"], ())
            if lane in self._numbers
        ]
