"""Charts as SVG: the pictures of a drive and of a run, in one style, for the HTML report and
`replan plot`.

chart.py                  `Chart`: SVG, PNG, part of a page
style.py, svg.py          colours and classes; elements
simplify.py, legend.py    fewer points for the same lines; samples with their words
axes.py                   plot areas with a scale and ticks
subject.py                the data of a drive's pictures, when to look at it, when gates broke
bird_view.py, curves.py   the pictures of a drive
layout.py                 their names and places, charts of users, several charts as one

Nothing is measured here: the charts show the trace, the tables and the series of the run.
"""

from replan.draw.charts.bird_view import scene, scenes
from replan.draw.charts.chart import Chart
from replan.draw.charts.curves import curves, decisions, sl_graph, st_graph
from replan.draw.charts.subject import Moment, Subject, subject, worst_moment

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
