"""What is run to learn about replan itself, from a clone: `python -m studies.commonroad`.

Not in the wheel.
"""
