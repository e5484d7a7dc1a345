"""Planners: Frame -> Plan. `replan.replay.parts` has their names.

To write your own, read `logs/frame.py` (the input of a planner) and `planners/constant_speed.py`
(the template).
"""

from replan.core.former_names import refuse_copy

refuse_copy(__name__, "replan.planners")
