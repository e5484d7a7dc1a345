"""Traffic: the log without one road user."""


class Without:
    """The log without one road user."""

    due, notes = float("inf"), ()  # when it looks at the ego next: never

    def __init__(self, scenario, *, who: str = ""):
        self.tracks = scenario.tracks.only([name for name in scenario.tracks.ids if name != who])

    def step(self, ego):
        """Return the road users around the ego."""
        return self.tracks
