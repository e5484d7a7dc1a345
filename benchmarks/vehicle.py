"""What the vehicle models cost: `python benchmarks/vehicle.py`.

Prints microseconds of a dynamics sub-step inside the kernel (aim: 2 us), and of a whole control
step of 10 ms by the model's `step`, as the loop calls it. Median of ROUNDS.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from time import perf_counter

from replan.core.errors import ConfigError
from replan.logs.states import Command, EgoState
from replan.logs.vehicle import vehicle_parameters
from replan.replay.parts import VEHICLE
from replan.replay.vehicle.drivetrain import Drivetrain
from replan.replay.vehicle.single_track import advance, car_of, cornering
from replan.replay.vehicle.tyres import TYRES

ROUNDS, SUBSTEPS = 50, 1000
AIM_US = 2.0
START = EgoState(0.0, 0.0, 0.0, 0.0, 20.0, 0.0, 0.005)
CAR = vehicle_parameters("bmw_320i")


def median_us(call: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Median time of a call, us; the first, which may compile, is not counted."""
    call()
    times = []
    for _ in range(rounds):
        before = perf_counter()
        call()
        times.append(1e6 * (perf_counter() - before))
    return median(times)


def substep_us(tyre: str) -> float:
    """A Runge-Kutta sub-step of the single-track model inside its kernel, us."""
    train = Drivetrain(CAR)
    car = car_of(CAR, train, tyre=tyre)
    state = cornering(car, START, train)
    box, held = train.gearbox(state.vx, state.throttle), (0.03, 0.2, 0.0)
    return median_us(lambda: advance(state, box, held, car, 2.0, SUBSTEPS)) / SUBSTEPS


def step_us(name: str) -> float:
    """A control step of 10 ms, us."""
    vehicle = VEHICLE.builtin[name](CAR, START)
    return median_us(lambda: vehicle.step(Command(0.02, 0.1, 0.0), 0.01), 500)


def main() -> None:
    """Measure and print."""
    for tyre in TYRES:
        took = substep_us(tyre)
        verdict = "met" if took <= AIM_US else "MISSED"
        print(f"single_track sub-step, {tyre:8s} {took:9.2f} us   aim {AIM_US} us: {verdict}")
    for name in VEHICLE.builtin:
        if name == "perfect":
            continue
        try:
            print(f"step of 10 ms, {name:20s} {step_us(name):9.1f} us")
        except ConfigError as error:
            print(f"step of 10 ms, {name:20s} not measured: {error}")


if __name__ == "__main__":
    main()
