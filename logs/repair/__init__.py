"""Makes tracks from raw detections: offline for metrics, causally for planners.

Modules:
    detected_boxes.py   boxes of one frame: constants by group, overlap, two boxes of one object
    association.py      the filter of a track; detections joined to tracks
    tracker.py          road users from the frames up to now
    detections.py       raw detections; the record of a repair; names of tracks
    users.py, offline.py   tracks from the whole log
"""
