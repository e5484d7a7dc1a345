"""`replan vary`: evaluates a surface of pass and fail over one or two varied parameters of a recording.

    question.py    the varied parameters and their values
    conflict.py    distances of road users to the ego, to choose the agents to vary
    brackets.py    where a row stops passing, by bisection
    surface.py     cells -> varied logs -> `replay.run` -> table, edges, picture

The picture is drawn by `replay.vary.surface_figure`.
"""

from replay.vary.conflict import encounters, prepared
from replay.vary.question import Axis, SurfaceQuestion, question
from replay.vary.surface import VaryResult, vary

__all__ = ["Axis", "SurfaceQuestion", "VaryResult", "encounters", "prepared", "question", "vary"]
