"""Mining: finds events in logs without a planner, and writes the moments as tables and as separate
logs.

driven_log.py     the type of events; a prepared log: the recorded drive on a time
grid, road users in the frame of its path
road_users.py     kinds with another road user; ego_and_road.py, conflicts.py: the other kinds
kinds.py          the table of kinds; plan_kinds.py, the kinds of a planner's plans; kinds_page.py,
                  docs/events.md
mine.py           `replan mine`: each log once, events.parquet and the other tables
query.py          `replan query`: SQL over a folder's tables; `replan cut`: logs of the moments that
                  a query finds
coverage.py       which cells of kind, road, road user and speed a set of logs has
suite.py          `replan suite`: the fewest logs that have all cells
"""
