"""What lies in the ego's way, or asks it to drive slower: one file per reason."""
