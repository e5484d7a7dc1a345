"""Planners in separate processes: a planner that is not built in has its own process, and receives only frames.

schema      the messages (docs/planners_apart.md describes each field), and their conversion
channel     messages over file descriptors, with deadlines
launcher    a small warm process per worker from which planners' processes are forked, and templates of them
processes   the worker's side of the launcher: starts a process, waits for it, kills it
child       the Python planner in its process
connection  requests with time limits, and the planner object for a loop
batch       several logs in lock step, whose frames one planner plans at once
"""
