"""What the readers of published data sets share: their tables, poses, boxes and lanes.

Modules:
    tables.py   Arrow files and their columns as arrays
    boxes.py    boxes by frame -> tracks; the ego's states from recorded poses, and its vehicle
    strips.py   lanes between two lines, their neighbours and markings
"""
