"""How often noise in the others' tracks changes a reference driver's verdict, and whether its
margin says so.

    python benchmarks/verdicts.py [--drives 98] [--seeds 1]

Drives: the catalogue's pedestrians and cut-ins over a grid of speeds and distances, from which as
many as are asked for are taken at even intervals among those in which the ego would meet somebody.
Each is sampled at 10, 25 and 100 Hz, with and without logged velocities, and 2 or 5 cm of seeded
Gaussian noise is added to every moving agent's positions. A flip is a verdict other than that of
the same samples without noise; it is marked if either of the two is called marginal.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
from scipy.interpolate import PchipInterpolator

from replan.logs.catalogue import CATALOGUE
from replan.logs.reference_line import ReferenceLine
from replan.logs.scenario import Avoidability, DriverVerdict, Scenario
from replan.logs.tracks import Tracks
from replan.metrics.reference_drivers import DRIVERS
from replan.replay.loop.reference_drives import reference_line

NOISE_M = (0.02, 0.05)
RATES_HZ = (10.0, 25.0, 100.0)
PEDESTRIANS = (
    ("ego_speed_mps", (8.0, 11.0, 14.0)),
    ("distance_m", (6.0, 10.0, 14.0, 18.0, 22.0, 27.0, 33.0)),
)
CUT_INS = (
    ("ego_speed_mps", (14.0, 18.0, 22.0)),
    ("gap_m", (3.0, 5.0, 7.0, 10.0, 14.0, 20.0)),
    ("relative_speed_mps", (-4.0, -7.0, -10.0)),
    ("cut_in_duration_s", (2.0, 3.5)),
)
Drive = tuple[Scenario, ReferenceLine]


def grid() -> Iterator[Scenario]:
    """All variants of the families that can be built, also those in which the logged driver touches
    somebody.
    """
    for name, family in CATALOGUE.items():
        if not {"pedestrian", "cut_in"} & set(family.tags):
            continue
        axes = CUT_INS if "cut_in" in family.tags else PEDESTRIANS
        for values in product(*(values for _, values in axes)):
            changed = {axis: value for (axis, _), value in zip(axes, values, strict=True)}
            try:
                made = family.build({**family.parameters, **changed})
            # The walker is not off the lane, or the driver not at the goal, before the log ends
            except ValueError:
                continue
            yield replace(
                made,
                name=f"{name}@{','.join(f'{axis}={value:g}' for axis, value in changed.items())}",
            )


def drives(count: int) -> list[Drive]:
    """`count` of the grid's drives, evenly spread, in which the careful driver's verdict
    applies.
    """
    found = [(scenario, reference_line(scenario)) for scenario in grid()]
    found = [
        pair
        for pair in found
        if DRIVERS["cc"](*pair, None).outcome is not Avoidability.NOT_APPLICABLE
    ]
    return [found[i] for i in np.unique(np.linspace(0, len(found) - 1, count).astype(int))]


def sampled(tracks: Tracks, rate: float, noise: float, seed: int, *, velocities: bool) -> Tracks:
    """The tracks at `rate` Hz with noisy positions.

    Their velocities, where wanted, are the logged ones.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for i in range(len(tracks)):
        span = tracks.samples(i)
        t, columns = (
            tracks.t[span],
            [getattr(tracks, name)[span] for name in ("x", "y", "yaw", "vx", "vy")],
        )
        if not tracks.static[i]:
            fine = np.round(np.arange(t[0], t[-1] + 1e-9, 1.0 / rate), 9)
            columns = [PchipInterpolator(t, column)(fine) for column in columns]
            columns[:2] = [
                column + noise * rng.standard_normal(len(fine)) for column in columns[:2]
            ]
            t = fine
        rows.append(np.vstack([t, *columns]))
    t, x, y, yaw, vx, vy = np.hstack(rows)
    if not velocities:
        vx, vy = np.full((2, len(t)), np.nan)
    offsets = np.r_[0, np.cumsum([row.shape[1] for row in rows])]
    return Tracks(
        tracks.ids,
        tracks.kinds,
        tracks.length,
        tracks.width,
        tracks.static,
        offsets,
        t,
        x,
        y,
        yaw,
        vx,
        vy,
    )


def verdicts(
    drive: Drive, rate: float, noise: float, seed: int, *, velocities: bool
) -> dict[str, DriverVerdict]:
    """The verdict of each driver on one drive, resampled."""
    scenario, line = drive
    made = replace(
        scenario, tracks=sampled(scenario.tracks, rate, noise, seed, velocities=velocities)
    )
    return {name: driver(made, line, None) for name, driver in DRIVERS.items()}


def flips(chosen: list[Drive], seeds: int) -> pd.DataFrame:
    """A row per drive, rate, noise, seed, with or without velocities, and driver."""
    rows = []
    for velocities, rate, (at, drive) in product((False, True), RATES_HZ, enumerate(chosen)):
        clean = verdicts(drive, rate, 0.0, 0, velocities=velocities)
        for noise, seed in product(NOISE_M, range(seeds)):
            noisy = verdicts(drive, rate, noise, 1000 * at + seed, velocities=velocities)
            for name, one in clean.items():
                two = noisy[name]
                key = {"velocities": velocities, "noise_m": noise, "rate_hz": rate, "driver": name}
                flipped = one.outcome is not two.outcome
                marked = flipped and (one.marginal or two.marginal)
                margins = {"margin_clean": one.margin, "margin_noisy": two.margin}
                what = {
                    "drive": drive[0].name,
                    "outcome": one.outcome.value,
                    "noisy": two.outcome.value,
                }
                rows.append(
                    key
                    | {
                        "flipped": flipped,
                        "unmarked": flipped and not marked,
                        "marginal": two.marginal,
                    }
                    | margins
                    | what
                )
    return pd.DataFrame(rows)


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drives", type=int, default=98)
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    chosen = drives(options.drives)
    table = flips(chosen, options.seeds)
    keys = ["velocities", "noise_m", "rate_hz", "driver"]
    once = table[table["rate_hz"] == RATES_HZ[0]]
    print(f"{len(chosen)} drives, noiseless:")
    print(
        once.groupby(["driver", "outcome"]).size().div(2 * len(NOISE_M) * options.seeds).to_string()
    )
    print(table.groupby(keys)[["flipped", "unmarked"]].sum().unstack("driver").to_string())
    for share in ("flipped", "unmarked", "marginal"):
        print(f"{share}: {table[share].mean():.2%}")
    print(table[table["flipped"]].drop(columns=["flipped", "marginal"]).to_string(index=False))


if __name__ == "__main__":
    main()
