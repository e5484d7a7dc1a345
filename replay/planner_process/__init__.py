"""Planners kept apart: whatever is not built in plans in a process of its own, and is sent frames, nothing else.

schema      the messages (docs/planners_apart.md describes them field by field), and their nouns
channel     messages over file descriptors, with deadlines
launcher    a small warm process per worker from which planners' processes are forked, and templates of them
processes   the worker's side of it: a process that is started, waited for, killed
child       the Python planner in its process
link        a message and its answer, within limits
together    several logs in lock step, whose frames one planner plans at once
proxy       the planner that a loop sees
"""
