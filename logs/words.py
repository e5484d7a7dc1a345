"""Words of counts, as messages say them."""

from __future__ import annotations


def counted(count: int, thing: str) -> str:
    """A number of things: "1 agent", "2 agents", "0 buses"."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}{'es' if thing.endswith(('s', 'x', 'ch')) else 's'}"
