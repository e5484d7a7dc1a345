"""The calibration table: acceleration x speed -> pedals, as the vehicle's own model has it in steady state.

(1) pedal(a, v) > 0: throttle, < 0: brake;  beyond = a - coasting(v)
    pedal = beyond / full_throttle(v) where beyond >= 0, beyond / full_brake(v) where it is negative; NaN out of reach

Such a table is measured on a car whose drive train cannot be inverted. Here the power train is known and linear
in the pedal at each speed, so the controllers (`Pedals`) use the exact inverse: no error between the table's nodes, no
file to keep in step with the vehicle. The table is for the reader, and to drive a real car by.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.errors import ConfigError
from logs.kernel import FloatArray, frozen
from replay.vehicle.base import Powertrain

SPEEDS_MPS = np.arange(0.0, 50.1, 1.0)
ACCELERATIONS_MPS2 = np.arange(-9.0, 5.1, 0.25)


@dataclass(frozen=True, eq=False)
class Calibration:
    """The table (1).

    Attributes:
        speed: `(n,)` m/s, increasing.
        acceleration: `(m,)` m/s2, increasing.
        pedal: `(m, n)`; throttle positive, brake negative, -1 to 1; NaN where the vehicle cannot.
    """

    speed: FloatArray
    acceleration: FloatArray
    pedal: FloatArray

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "pedal"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @classmethod
    def of(
        cls,
        powertrain: Powertrain,
        speed: FloatArray = SPEEDS_MPS,
        acceleration: FloatArray = ACCELERATIONS_MPS2,
    ) -> Calibration:
        """The table of a power train."""
        coasting, throttle, brake = (
            np.array([of(float(v)) for v in speed])
            for of in (powertrain.coasting, powertrain.full_throttle, powertrain.full_brake)
        )
        beyond = acceleration[:, None] - coasting
        pedal = np.divide(beyond, np.where(beyond >= 0.0, throttle, brake))
        return cls(speed, acceleration, np.where(np.abs(pedal) <= 1.0, pedal, np.nan))

    def at(self, acceleration: float, v: float) -> tuple[float, float]:
        """Throttle and brake by bilinear interpolation, held at the table's ends; NaN out of the vehicle's reach."""
        i, u = _place(self.acceleration, acceleration)
        j, w = _place(self.speed, v)
        corners = self.pedal[i : i + 2, j : j + 2]
        pedal = float(np.array([1.0 - u, u]) @ corners @ np.array([1.0 - w, w]))
        return max(pedal, 0.0) if pedal == pedal else pedal, max(-pedal, 0.0) if pedal == pedal else pedal

    def save(self, path: Path) -> None:
        """Write it as CSV: a row per acceleration, a column per speed; empty where the vehicle cannot."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["acceleration_mps2", *(f"{v:g}_mps" for v in self.speed)])
            for a, row in zip(self.acceleration, self.pedal, strict=True):
                writer.writerow([f"{a:g}", *("" if np.isnan(value) else f"{value:.6f}" for value in row)])

    def plot(self, path: Path) -> None:
        """Draw it as a picture (format by the path's ending).

        Raises:
            ConfigError: matplotlib is not installed.
        """
        try:
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
        except ImportError:
            raise ConfigError("plots need matplotlib: install it, or write the CSV only") from None
        figure = Figure(figsize=(7.0, 4.5), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        mesh = axes.pcolormesh(
            self.speed, self.acceleration, np.ma.masked_invalid(self.pedal),
            cmap="RdBu", vmin=-1.0, vmax=1.0, shading="nearest",
        )  # fmt: skip
        axes.set_xlabel("speed, m/s")
        axes.set_ylabel("acceleration, m/s2")
        figure.colorbar(mesh, ax=axes, label="pedal: throttle > 0, brake < 0")
        figure.savefig(path, dpi=150)


def _place(grid: FloatArray, value: float) -> tuple[int, float]:
    """Cell of a value in an increasing grid and its share of it, 0 to 1; the ends hold."""
    i = int(np.clip(np.searchsorted(grid, value, side="right") - 1, 0, len(grid) - 2))
    return i, float(np.clip((value - grid[i]) / (grid[i + 1] - grid[i]), 0.0, 1.0))
