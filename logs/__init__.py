"""Logs: the shared data classes, readers and writers.

Frames: world W (unsuffixed), `_ego` (x forward, y left), `_frenet` (s along, l left). The ego's
reference point is its rear axle, an agent's the centre of its box. SI units inside; units stand in
names only at the edges (files, options, tables). Time: integer nanoseconds in logs and loops,
seconds since the scenario's start inside numerics.

    Scenario      a log: ego, tracks of the road users, road, goal
    EgoState      the ego at one instant           Trajectory    ego states over time
    Agents        road users at one instant        Tracks        road users over time
    Frame         the input of a planner           Predictions   predicted futures of the agents
    Plan          the output of a planner          Command       steering and pedals
    Trace         one drive of one planner
    Road, Lane, Goal, ReferenceLine                the road and the goal on it
    StopLine, Crosswalk, TrafficLight, Colour      traffic rules
    VehicleParameters                              the ego's vehicle
"""

from replan.core.former_names import refuse_copy

refuse_copy(__name__, "replan.logs")
