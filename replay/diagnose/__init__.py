"""`replan diagnose`: finds why drives fail, by driving them again with one change.

changes.toml   the changes: an ideal part in place of one, defaults, wider limits, another planner
changes.py     changed runs; and the cause ("not found" if there is none) from the changes that turn FAIL into PASS
drives.py      the failing drives of a run, driven again with each change and judged by its gates
failure.py     the failure of a drive in words: compared with the drive that passes, and with predictions
diagnose.py    a whole diagnosis: the failing drives with each change, and the conclusions
findings.py    the findings of a diagnosis: sentences, page, tables
remedy.py      the smallest change of one setting that passes, and the drives of the run that it breaks
"""
