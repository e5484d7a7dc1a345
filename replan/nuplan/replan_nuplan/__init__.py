"""The nuPlan side: an `AbstractPlanner` behind replan's messages, for Python 3.9 and later.

It imports numpy, shapely, msgpack and the devkit, and nothing of replan.
"""
