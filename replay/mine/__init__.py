"""Mining: what happened in logs, found without a planner; the moments as tables and as logs of their own.

driven_log.py     what an event is; a log laid out: the recorded drive on a grid, road users in the frame of its path
road_users.py     kinds with another road user; ego_and_road.py, conflicts.py: the other kinds
kinds.py          the table of kinds, and those of a planner's plans
mine.py           `replan mine`: each log once, events.parquet and the other tables
query.py          `replan query`: SQL over a folder's tables; `replan cut`: logs of the moments that a query finds
coverage.py       which cells of kind, road, road user and speed a set of logs has; `replan suite`: the fewest that do
"""
