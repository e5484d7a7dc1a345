"""What is run to learn about replan itself: controllers compared, the pedestrian varied, the paper reproduced."""
