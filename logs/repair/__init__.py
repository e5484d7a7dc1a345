"""Makes tracks from raw detections: offline for metrics, causally for planners."""
