"""Path stage: which side of each obstacle (DP), the smoothest path (QP), and the bounds that it keeps."""
