"""`replan falsify` and `replan tune`: search for the mildest failure of a planner, and for better settings.

    axes.py        a log or family, what is varied of it and how far, and the scenario of a point of these axes
    mildest.py     the search: spread points, CMA-ES, fewer axes, bisection
    falsify.py     a falsification from its words to its files: who fails which gate, and a score that leads the search
    space.py       a TOML file -> settings that are searched
    gains.py       training and held-out logs; metrics of a run against those of the defaults
    trials.py      which settings are tried next, and their rows
    tune.py        a tuning from its space to its files
    study.py       the file of trials of both, by which an interrupted search goes on
    figures.py     their pictures

optuna and cmaes are an extra, and imported where a search begins.
"""
