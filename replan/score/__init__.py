"""Scores that stand beside the leaderboards of nuPlan and NAVSIM: `replan score`.

Modules:
    window.py            what a window of a log holds: route, other road users, red lights
    navsim.py            how NAVSIM drives a plan; its parts, by version
    yardstick.py         NAVSIM's scores of plans, and PDM-Closed, with which it compares progress
    submitted_plans.py   the trajectories of a file or a run
    score_table.py       a table of scores: scenes, and a summary for each agent
    nuplan_table.py      the table of nuPlan
    navsim_table.py      the table of NAVSIM
    two_stages.py        the weights and means of NAVSIM's two stages
"""
