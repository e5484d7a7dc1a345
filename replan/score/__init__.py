"""Scores that stand beside the leaderboards of nuPlan and NAVSIM: `replan score`.

Modules:
    window.py        what a window of a log holds: route, other road users, red lights
    navsim.py        how NAVSIM drives a plan; its parts, by version
    yardstick.py     NAVSIM's scores of plans, and PDM-Closed, with which it compares progress
    score_table.py   the trajectories of a file or a run; the table of scores; two stages
"""
