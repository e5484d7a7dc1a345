"""Starts the nuPlan side in the interpreter of the planner; imports nothing of replan."""

import runpy

if __name__ == "__main__":
    runpy.run_module("replan_nuplan.nuplan_main", run_name="__main__")
