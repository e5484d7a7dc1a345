"""Run the loops: open and closed loop, perception, planning, the end of a drive, reference
drives.
"""
