"""The files of a run: those of each log, the tables of the run, and functions that read them back
(`load`).
"""
