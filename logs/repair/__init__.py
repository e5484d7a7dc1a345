"""Makes tracks from raw detections: offline for metrics, causally for planners."""

from logs.repair.identities import needs_repair
from logs.repair.offline import detections_of, repair
from logs.repair.tracker import Tracked, tracked

__all__ = ["Tracked", "detections_of", "needs_repair", "repair", "tracked"]
