"""`replan calibrate`: the calibration table of a vehicle, written and drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from replan.config import load_run
from replan.core.errors import ConfigError
from replan.draw.charts.axes import Plane
from replan.draw.charts.chart import Chart
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.control.pedals import Calibration
from replan.replay.parts import VEHICLE, Part
from replan.replay.vehicle import build_vehicle
from replan.results.tables import write_file
from replan.run.claim import FolderContents, claimed_folder

CONTENTS = FolderContents("calibrate", ("calibration.csv", "calibration.png"), resumes=False)
STANDING = EgoState(0.0, 0.0, 0.0, 0.0, 0.0)


def calibrate(
    out: Path, model: str = "single_track", car: str | None = None, config: Path | None = None
) -> tuple[Path, Path]:
    """Write `calibration.csv` and `.png` of a vehicle into a folder.

    `out`: the folder; it is created if needed. `car`: name of a set of parameters in
    `logs/vehicles`; None: that of the configuration, else the default vehicle. `config`: a run's
    configuration, of which [vehicle] is used. ConfigError if a name is unknown, the model has no
    power train, or the folder must not be written.
    """
    if model == "perfect":
        raise ConfigError("the perfect vehicle has no pedals: there is nothing to calibrate")
    run = load_run(config, {} if car is None else {"vehicle": {"set": car}})
    parameters = run.driven(VehicleParameters())
    csv, png = (out / name for name in CONTENTS.names)
    with claimed_folder(out, CONTENTS):
        table = Calibration.of(
            build_vehicle(Part(VEHICLE, model), parameters, STANDING, {}).powertrain
        )
        write_file(csv, table.save)
        picture(table).save(png)
    return csv, png


def picture(table: Calibration) -> Chart:
    """The table as a heat map: throttle blue, brake red."""
    # Edges of cells
    speed, acceleration = (0.5 * (v[1:] + v[:-1]) for v in (table.speed, table.acceleration))
    x, y = (
        np.r_[2.0 * e[0] - e[1], e, 2.0 * e[-1] - e[-2]].tolist() for e in (speed, acceleration)
    )
    plane = Plane((x[0], x[-1]), (y[0], y[-1]), 640.0, 420.0)
    inside = "".join(
        plane.heat((x[j], x[j + 1]), (y[i], y[i + 1]), float(table.pedal[i, j]), (-1.0, 1.0))
        for i, j in np.argwhere(np.isfinite(table.pedal)).tolist()
    )
    entries = [("area", "blue", "full throttle"), ("area", "red", "full brake")]
    titles = dict[str, Any](x_title="speed [m/s]", y_title="acceleration [m/s²]", entries=entries)
    return plane.chart(
        "calibration", "Pedal by speed and acceleration; fainter: less", inside, **titles
    )
