"""Planners kept apart: a planner that is not built in plans in a process of its own, and receives only frames.

schema      the messages (docs/planners_apart.md describes them field by field), and their nouns
channel     messages over file descriptors, with deadlines
launcher    a small warm process per worker from which planners' processes are forked, and templates of them
processes   the worker's side of it: a process that is started, waited for, killed
child       the Python planner in its process
connection  a message and its answer within limits, and the planner that a loop sees
batch       several logs in lock step, whose frames one planner plans at once
"""
