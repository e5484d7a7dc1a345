"""Charts as SVG: the pictures of a drive and of a run, in one style, for the HTML report and `replan plot`.

canvas.py    elements, simplification, `Chart`           axes.py      plot areas with a scale and ticks
style.py     colours by role, light and dark             picture.py   several charts as one file, SVG or PNG
moment.py    when to look at a drive, when gates broke   subject.py   the data of a drive's pictures
scene.py, graphs.py, curves.py, lanes.py                 the pictures of a drive
layout.py                                                their names and places, and charts of users

Nothing is measured here: the charts show the trace, the tables and the series of the run.
"""

from replay.draw.charts.canvas import Chart
from replay.draw.charts.curves import curves
from replay.draw.charts.graphs import sl_graph, st_graph
from replay.draw.charts.lanes import decisions
from replay.draw.charts.moment import Moment, worst_moment
from replay.draw.charts.scene import scene, scenes
from replay.draw.charts.subject import Subject, subject

__all__ = [
    "Chart",
    "Moment",
    "Subject",
    "curves",
    "decisions",
    "scene",
    "scenes",
    "sl_graph",
    "st_graph",
    "subject",
    "worst_moment",
]
