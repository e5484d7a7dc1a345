"""`replan diagnose`: why drives fail, by driving them again with one thing changed.

changes.toml   the changes: an ideal part in place of one, defaults, wider limits, another planner
changes.py     a change of a run -> another run
causes.py      which changes turn FAIL into PASS -> a cause, or "not found"
drives.py      the failing drives of a run, driven again with each change and judged by its gates
diagnose.py    a diagnosis from its words to its files
remedy.py      the smallest change of one setting that passes, and what it breaks in the rest of the run
"""
