"""Stand-ins of other projects' controllers: our own laws behind the interfaces that glue calls."""

from __future__ import annotations

import textwrap
from pathlib import Path

BENCH2DRIVE = """
    import numpy as np

    class PIDController:
        def control_pid(self, waypoints, speed, target):
            speed = float(speed.astype(np.float64))
            assert waypoints.shape == (6, 2) and target.shape == (2,)
            distances = np.linalg.norm(waypoints, axis=1)
            right, ahead = waypoints[np.abs(distances - 5.0).argmin()]
            wanted = 2.0 * np.linalg.norm(np.diff(waypoints, axis=0), axis=1).mean()
            brake = speed > 1.1 * wanted
            throttle = 0.0 if brake else np.clip(0.5 * (wanted - speed), 0.0, 0.75)
            return np.clip(np.arctan2(right, ahead), -1.0, 1.0), throttle, brake, {}
"""
CHALLENGE = """
    class Controller:
        def __init__(self):
            self.sum = 0.0

        def update(self, target_lataccel, current_lataccel, state, future_plan):
            assert len(future_plan.lataccel) == len(future_plan.v_ego) == 49
            assert state.v_ego >= 0.0 and state.roll_lataccel == 0.0
            self.sum += 0.05 * (target_lataccel - current_lataccel)
            return target_lataccel / 1.5 + self.sum
"""
COMMONROAD = """
    class PIDLongLat:
        def __init__(self, kp_long, ki_long, kd_long, kp_lat, ki_lat, kd_lat, delta_t):
            self.gain, self.damping, self.period = 2.0 * kp_lat, kd_lat, delta_t
            self.last = 0.0

        def compute_control_input(
            self, measured_v_long, reference_v_long, measured_lat_offset, reference_lat_offset=0.0
        ):
            offset = measured_lat_offset - reference_lat_offset
            rate, self.last = (offset - self.last) / self.period, offset
            steering_rate = -self.gain * offset - self.damping * rate
            return reference_v_long - measured_v_long, steering_rate
"""
OPENPILOT = """
    import math

    class LatControlTorque:
        def __init__(self, CP, CI, dt):
            self.tuning, self.interface = CP.lateralTuning.torque, CI

        def update(
            self, active, CS, VM, params, steer_limited_by_safety, desired_curvature,
            curvature_limited, lat_delay,
        ):
            angle = math.radians(CS.steeringAngleDeg - params.angleOffsetDeg)
            measured = -VM.calc_curvature(angle, CS.vEgo, params.roll)
            wanted = desired_curvature + 0.5 * (desired_curvature - measured)
            torque = self.interface.torque_from_lateral_accel()(wanted * CS.vEgo**2, self.tuning)
            return -torque, 0.0, None
"""
FILES = {
    "team_code/pid_controller.py": BENCH2DRIVE,
    "controllers/pid.py": CHALLENGE,
    "commonroad_control/control/pid/pid_long_lat.py": COMMONROAD,
    "openpilot/selfdrive/controls/lib/latcontrol_torque.py": OPENPILOT,
}
"""Path in a clone or a package -> text of the stand-in."""


def write_standins(folder: Path) -> None:
    """Write all stand-ins into a folder, as packages."""
    for path, text in FILES.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(textwrap.dedent(text), encoding="utf-8")
