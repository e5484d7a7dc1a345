"""Mining: what happened in logs, found without a planner; the moments as tables and as logs of their own.

driven_log.py     a log laid out: the recorded drive on a grid, road users in the frame of its path
events.py         what an event and a kind of event are
road_users.py     kinds with another road user; ego_and_road.py, conflicts.py: the other kinds
kinds.py          the table of kinds
mine.py           `replan mine`: each log once, events.parquet and the other tables
query.py          `replan query`: SQL over a folder's tables
cut.py            `replan cut`: logs of the moments that a query finds
coverage.py       which cells of kind, road, road user and speed a set of logs has
suite.py          `replan suite`: the fewest logs that have them all
"""
