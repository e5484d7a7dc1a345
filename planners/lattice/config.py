"""Settings of the lattice planner."""

from __future__ import annotations

from dataclasses import dataclass

from planners.frenet.profiles import STEP_S


@dataclass(frozen=True)
class LatticeConfig:
    """Settings of `lattice`; in brackets the names of (1) and (2) in `planners.lattice.candidates`.

    Attributes:
        speeds: Number of end speeds between 0 and the wanted one.
        durations_s: Of longitudinal polynomials (T).
        lateral_durations_s: Of lateral ones (T_l).
        offset_spacing_m: Between two end offsets.
        w_jerk: Weight k_j; `w_time` k_t, `w_offset` k_l, `w_speed` k_v, `w_point` k_s, `w_gap` k_gap.
        w_lateral: Weight of the lateral part (K_LAT).
        w_lateral_time: Weight of the lateral duration (k_u): so small that an offset of `offset_spacing_m` is undone.
        standstill_gap_m: Wanted gap at standstill (g0).
        time_gap_s: Wanted time gap (tau).
        accel_mps2: Greatest acceleration.
        decel_mps2: Hardest deceleration, positive.
        lat_accel_mps2: Greatest lateral acceleration.
        curve_accel_mps2: Lateral acceleration from which the wanted speed in curves comes.
        ease_mps2: Deceleration towards lower limits and curves.
        margin_m: To vehicles and objects; `vulnerable_margin_m` to pedestrians and riders.
        edge_m: To the road's edge.
    """

    speeds: int = 8
    durations_s: tuple[float, ...] = (2.0, 3.0, 4.0, 6.0, 8.0)
    lateral_durations_s: tuple[float, ...] = (2.5, 4.0, 6.0)
    offset_spacing_m: float = 0.5
    w_jerk: float = 1.0
    w_time: float = 1.0
    w_offset: float = 2.0
    w_speed: float = 1.0
    w_point: float = 0.1
    w_gap: float = 150.0
    w_lateral: float = 1.0
    w_lateral_time: float = 0.1
    standstill_gap_m: float = 2.0
    time_gap_s: float = 1.2
    accel_mps2: float = 2.5
    decel_mps2: float = 7.5
    lat_accel_mps2: float = 4.0
    curve_accel_mps2: float = 2.5
    ease_mps2: float = 1.5
    margin_m: float = 0.3
    vulnerable_margin_m: float = 0.5
    edge_m: float = 0.1

    def __post_init__(self) -> None:
        if self.speeds < 2 or not self.durations_s or not self.lateral_durations_s or not self.offset_spacing_m > 0.0:
            raise ValueError("lattice needs two speeds, durations and a positive offset_spacing_m")
        if min((*self.durations_s, *self.lateral_durations_s)) < STEP_S:
            raise ValueError(f"lattice durations must be at least {STEP_S} s")
