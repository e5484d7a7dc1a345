"""`replan diagnose`: why drives fail, by driving them again with one thing changed.

changes.toml   the changes: an ideal part in place of one, defaults, wider limits, another planner
changes.py     a change of a run -> another run; which changes turn FAIL into PASS -> a cause, or "not found"
drives.py      the failing drives of a run, driven again with each change and judged by its gates
failure.py     what goes wrong in a drive, in words: beside the drive that passes, and what was predicted
diagnose.py    a diagnosis: the failing drives with each change, and what that shows
findings.py    what a diagnosis found: sentences, page, tables
remedy.py      the smallest change of one setting that passes, and what it breaks in the rest of the run
"""
