"""Drives a log: loops, perception, prediction, traffic, controllers, vehicles, and planners in
their own process.
"""

from replan.core.former_names import refuse_copy

refuse_copy(__name__, "replan.replay")
