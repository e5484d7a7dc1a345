"""One candidate lane planned, and the choice between lanes."""
