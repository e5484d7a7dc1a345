"""Scores that stand beside the leaderboards of nuPlan and NAVSIM: `replan score`.

Modules:
    navsim_tracker.py  how NAVSIM drives a plan
    window.py          what a window of a log holds: route, other road users, red lights
    pdm_closed.py      PDM-Closed, with which NAVSIM compares progress
    navsim.py          NAVSIM's parts and scores, by version
    trajectories.py    the trajectories of a file or a run
    score_table.py     the table of scores
"""
