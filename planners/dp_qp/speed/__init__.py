"""Speed stage: the order of passing (DP), the smoothest speed (QP), and the strength of braking."""
