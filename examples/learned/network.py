"""The network: each agent with the ego's inputs through a small perceptron, the strongest of each
channel over all agents, and a perceptron that answers speeds and offsets. 90,000 weights.
"""

import torch
from route_view import AGENT_INPUTS, EGO_INPUTS, KNOTS_M, KNOTS_S
from torch import nn


class Net(nn.Module):
    """Speeds `(B, 8)` and offsets `(B, 5)` from the inputs of `route_view`."""

    def __init__(self, width=128):
        super().__init__()
        self.ego = nn.Sequential(nn.Linear(EGO_INPUTS, width), nn.ReLU(), nn.Linear(width, width))
        self.agent = nn.Linear(AGENT_INPUTS, width)
        self.both = nn.Sequential(
            nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.head = nn.Sequential(
            nn.Linear(2 * width, 2 * width), nn.ReLU(), nn.Linear(2 * width, width), nn.ReLU()
        )
        self.speeds = nn.Linear(width, len(KNOTS_S))
        self.offsets = nn.Linear(width, len(KNOTS_M))

    def forward(self, ego, agents, mask):
        """Differences of speed from now, and offsets."""
        own = self.ego(ego)
        rows = mask.nonzero()[:, 0]  # most places for agents are empty
        tokens = self.both(self.agent(agents[mask]) + own[rows])
        places = rows[:, None].expand_as(tokens)
        strongest = torch.zeros_like(own).scatter_reduce(0, places, tokens, "amax")
        shared = self.head(torch.cat([own, strongest], dim=-1))
        speed = 10.0 * ego[:, :1] + torch.cumsum(self.speeds(shared), dim=1)
        return speed, self.offsets(shared)
