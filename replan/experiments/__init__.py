"""Experiments: questions that are answered by driving many variations.
`replan vary | falsify | tune | diagnose`.

    trial.py           shared by all: scenarios made, driven and read as trials; tables of trials
    recorded_log.py    the recorded log prepared for variation
    ego_encounters.py  distances of road users to the ego, and the one in conflict with it

    vary       a surface of pass and fail over one or two parameters
    question.py        the varied parameters and their values
    surface.py         cells -> trials -> table, edges (brackets.py, by bisection), picture

    falsify    the mildest variation in which a planner fails and the reference driver does not
    search_subject.py  a log or family, its axes and their scales, and the scenario of a point on
                       them
    mildest.py         the search: spread points, CMA-ES, fewer axes, bisection
    falsify.py         the failed gates of both drivers, the score that guides the search, the files

    tune       settings that are better than the defaults on logs that were not searched
    space.py           the settings to search, from a TOML file
    held_out.py        the logs on which the search does not look
    gains.py           metrics of a run against those of the defaults
    optuna_trials.py, tune.py  the settings to try next; a whole tuning

    diagnose   why drives fail: driven again with one thing changed
    changes.py         the changes (changes.toml), and the cause to which those that pass point
    drives.py          the failing drives with each change, judged by their gates
    failure.py         the failure of a drive: compared with the drive that passes, and with
                       predictions; failure_words.py, the words
    remedy.py          the smallest change of one setting that passes, and the drives of the run
                       that it breaks
    diagnose.py, diagnosis.py  a whole diagnosis, and its sentences, page and tables

Each takes its question, and `out`, a folder that is new, empty, or holds an earlier result, which
is replaced or, with `resume`, gone on with (None: the next free one); `workers`, the number of
processes, 0 for this one (or an engine, None for this process); and `say`, which is called with
lines of progress. The results do not depend on `workers`.

`replan.run.resume` is the file from which an interrupted experiment goes on; surface_figure.py,
falsify_figure.py and pareto_figure.py draw the pictures. optuna and cmaes are an extra, and are
imported when a search begins.
"""
