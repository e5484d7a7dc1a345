"""Path stage: the side of each obstacle (DP), the smoothest path (QP), and its bounds."""
