"""What the readers of published data sets share: their tables, poses, boxes and lanes.

Modules:
    tables.py   Arrow files and their columns as arrays
    poses.py    quaternions; the ego's states from recorded poses
    boxes.py    boxes by frame -> tracks; the ego's vehicle
    strips.py   lanes between two lines, their neighbours and markings
"""
