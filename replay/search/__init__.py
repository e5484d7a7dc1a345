"""`replan falsify` and `replan tune`: search for the mildest failure of a planner, and for better settings.

    axes.py        what a falsification varies, how far, and what counts as one step of distance
    subject.py     a point of these axes -> a scenario
    cases.py       a scenario -> who fails which gate, and a score that leads the search
    mildest.py     the search: spread points, CMA-ES, fewer axes, bisection
    falsify.py     a falsification from its words to its files
    space.py       a TOML file -> settings that are searched
    split.py       logs -> training and held-out logs
    gains.py       metrics of a run against those of the defaults; is a change more than chance?
    tune.py        a tuning from its space to its files
    study.py       the file of trials of both, by which an interrupted search goes on
    figures.py     their pictures

optuna and cmaes are an extra, and imported where a search begins.
"""
