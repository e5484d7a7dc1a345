"""`replan falsify` and `replan tune`: search for the mildest failure of a planner, and for better settings.

    search_space.py    a log or family, its axes and their scales, and the scenario of a point on them
    mildest.py         the search: spread points, CMA-ES, fewer axes, bisection
    falsify.py         a whole falsification: the failed gates of both drivers, and the score that guides the search
    space.py           the settings to search, from a TOML file
    gains.py           training and held-out logs; metrics of a run against those of the defaults
    trials.py          the settings to try next, and the rows of trials
    tune.py            a whole tuning, from its space to its files
    search_figures.py  their pictures

optuna and cmaes are an extra, and are imported when a search begins. `replay.run.study` is the file of
trials of both, from which an interrupted search continues.
"""
