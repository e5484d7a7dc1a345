"""`replan vary`: one recording becomes a surface of pass and fail over one or two things that are varied in it.

    axes.py        what is varied, over which values
    encounters.py  who comes how near to the ego: which agents to vary
    surface.py     cells -> varied logs -> `replay.run` -> table, edges (where a row stops passing), picture

The picture is drawn by `replay.vary.surface_figure`.
"""

from replay.vary.axes import Axis, Question, question
from replay.vary.encounters import encounters, prepared
from replay.vary.surface import VaryResult, vary

__all__ = ["Axis", "Question", "VaryResult", "encounters", "prepared", "question", "vary"]
