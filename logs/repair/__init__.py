"""Raw detections made into tracks: offline for the judge, causally for planners."""

from logs.repair.needs import needs_repair
from logs.repair.offline import detections_of, repair

__all__ = ["detections_of", "needs_repair", "repair"]
