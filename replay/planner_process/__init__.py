"""Planners in separate processes: a planner that is not built in has its own process, and receives
only frames.

schema      the messages (docs/bring_planner.md describes each field), and their conversion
channel     messages over file descriptors, with deadlines
launcher    a small warm process per worker from which planners' processes are forked, and templates
            of them
processes   the worker's side of the launcher: starts a process, waits for it, kills it
child       the Python planner in its process
connection  requests with time limits, the planner object for a loop; several logs in lock step
"""
