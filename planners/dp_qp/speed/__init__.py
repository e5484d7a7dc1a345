"""Speed stage: the order of passing (DP), the smoothest speed (QP), and how hard to brake."""
