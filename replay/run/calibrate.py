"""`replan calibrate`: the calibration table of a vehicle, written and drawn."""

from __future__ import annotations

from pathlib import Path

from logs.errors import ConfigError
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from replay.config import load_run
from replay.control.pedals import Calibration
from replay.parts import VEHICLE, Part
from replay.results.tables import write_file
from replay.vehicle import build_vehicle

STANDING = EgoState(0.0, 0.0, 0.0, 0.0, 0.0)


def calibrate(
    out: Path, model: str = "single_track", car: str | None = None, config: Path | None = None
) -> tuple[Path, Path]:
    """Write `calibration.csv` and `.png` of a vehicle into a folder.

    Args:
        out: The folder; it is created if needed.
        model: Name of a vehicle model.
        car: Name of a set of parameters in `logs/vehicles`; None: that of the configuration, else the default vehicle.
        config: A run's configuration, of which [vehicle] is used.

    Raises:
        ConfigError: A name is unknown, the model has no power train, or the folder cannot be made.
    """
    if model == "perfect":
        raise ConfigError("the perfect vehicle has no pedals: there is nothing to calibrate")
    run = load_run(config, {} if car is None else {"vehicle": {"set": car}})
    parameters = run.driven(VehicleParameters())
    table = Calibration.of(build_vehicle(Part(VEHICLE, model), parameters, STANDING, {}).powertrain)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be the result folder: {error.strerror}") from None
    csv, png = out / "calibration.csv", out / "calibration.png"
    write_file(csv, table.save)
    write_file(png, table.plot)
    return csv, png
