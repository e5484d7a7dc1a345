"""Speed stage: who goes first (DP), the smoothest speed (QP), and how hard to brake."""
