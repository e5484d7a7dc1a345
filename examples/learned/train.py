"""Train the network on the arrays of `replan export features`, and write its weights.

    python train.py data/expert data/corrections -o weights.npz

A sample is learned from the plan that its log holds (of a trace: that of its planner), and where it
holds none, from what the driver did. Seeded: the same data give the same weights on one machine.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from network import Net
from route_view import NEEDED, inputs, targets, usable
from torch.nn.functional import smooth_l1_loss

BATCH = 512
TARGETS = ("plan", "plan_known", "future", "future_known")


def load(folder):
    """Inputs and targets of the samples in a folder, as tensors by name."""
    manifest = json.loads((folder / "features.json").read_text())
    parts = []
    for log in manifest["logs"]:
        for name in log["files"]:
            with np.load(folder / name) as file:
                stored = {key: file[key] for key in (*NEEDED, *TARGETS)}
            kind = "plan" if stored["plan_known"].any() else "future"
            kept = usable(stored) & stored[f"{kind}_known"][:, :20].all(axis=1)
            if kept.any():
                parts.append(_tensors({key: column[kept] for key, column in stored.items()}, kind))
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}


def _tensors(arrays, kind):
    speeds, known, offsets, share = targets(arrays, kind)
    tensors = inputs(arrays)
    tensors |= {"speeds": speeds, "known": known, "offsets": offsets, "share": share}
    return {name: torch.from_numpy(_single(array)) for name, array in tensors.items()}


def _single(array):
    return array if array.dtype == bool else array.astype(np.float32)


def loss_of(net, batch):
    """Huber loss of the known speeds and offsets; near ones count more."""
    speeds, offsets = net(batch["ego"], batch["agents"], batch["mask"])
    weight = torch.linspace(1.5, 0.5, speeds.shape[1]) * batch["known"]
    of_speed = smooth_l1_loss(speeds, batch["speeds"], reduction="none", beta=0.3) * weight
    share = batch["share"]
    of_offset = smooth_l1_loss(offsets, batch["offsets"], reduction="none", beta=0.1) * share
    return of_speed.sum() / weight.sum() + 2.0 * of_offset.sum() / share.sum()


def train(samples, *, epochs, seed, say=print):
    """Train a network on samples; one in 20 is kept apart to watch the loss."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # the batches are small
    torch.use_deterministic_algorithms(True)
    count = len(samples["ego"])
    order = torch.randperm(count)
    watched, learned = order[: count // 20], order[count // 20 :]
    net = Net()
    optimiser = torch.optim.AdamW(net.parameters(), lr=2e-3, weight_decay=1e-4)
    steps = epochs * (len(learned) // BATCH + 1)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=steps)
    for epoch in range(epochs):
        for rows in learned[torch.randperm(len(learned))].split(BATCH):
            optimiser.zero_grad()
            loss_of(net, {name: column[rows] for name, column in samples.items()}).backward()
            optimiser.step()
            schedule.step()
        with torch.no_grad():
            loss = loss_of(net, {name: column[watched] for name, column in samples.items()})
        if epoch % 5 == 4 or epoch == epochs - 1:
            say(f"epoch {epoch + 1}: loss {loss:.4f} of {len(watched)} samples kept apart")
    return net


def main():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=Path("weights.npz"))
    parser.add_argument("--epochs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    begin = time.perf_counter()
    parts = [load(folder) for folder in options.data]
    samples = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    print(f"{len(samples['ego'])} samples, read in {time.perf_counter() - begin:.0f} s")
    net = train(samples, epochs=options.epochs, seed=options.seed)
    with options.out.open("wb") as stream:
        np.savez(stream, **{name: weight.numpy() for name, weight in net.state_dict().items()})
    print(f"{options.out}: trained in {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
