"""Scores that stand beside the leaderboards of nuPlan and NAVSIM: `replan score`.

Modules:
    navsim_tracker.py  how NAVSIM drives a plan
    window.py          what a window of a log holds: route, other road users, red lights
    navsim.py          NAVSIM's parts, by version
    yardstick.py       NAVSIM's scores of plans, and PDM-Closed, with which it compares progress
    trajectories.py    the trajectories of a file or a run
    score_table.py     the table of scores; two stages
"""
