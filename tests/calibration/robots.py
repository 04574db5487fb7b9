"""Forty hidden robots, drawn from seeds that were committed before the first estimate: to tune on, and to report."""

from dataclasses import dataclass, fields, replace

import numpy as np

TUNING_SEEDS, REPORT_SEEDS = range(3500, 3520), range(3520, 3540)
TICK = 0.025  # [s] of the simulated robot, which quantizes its latencies
ROS_STEP = 0.05  # [s] of the task of the simulated robot over ROS, whose latencies are at most ten steps


@dataclass(frozen=True)
class HiddenRobot:
    """True parameters, in the terms of `tb2rl.simulation.spec.FIELDS`, wider than the preset `strong`."""

    wheel_radius: float
    wheel_separation: float  # true / nominal
    left_encoder: float
    right_encoder: float
    gyro: float
    acceleration: float  # true / nominal
    laser_noise: float  # [m]
    bias: float  # [m]
    dropped: float
    mount_x: float  # [m]
    mount_y: float  # [m]
    mount_yaw: float  # [rad]
    max_speed: float  # [m/s] of commands
    max_turn_rate: float  # [rad/s] of commands
    latency: float  # [s] until a command takes effect
    scan_age: float  # [s] from the measurement to the arrival of a scan

    scan_period: float = 0.1  # [s]

    @property
    def encoders(self) -> float:
        """Both encoders: distance measured / true, if the wheel radius is nominal."""
        return 0.5 * (self.left_encoder + self.right_encoder)

    @property
    def stamps_arrival(self) -> bool:
        """Whether the scans of this robot are stamped at their arrival, not when they were measured."""
        return self.gyro > 1.0


_LIMITS = HiddenRobot(  # type: ignore[arg-type]  # of uniform distributions
    (0.95, 1.05), (0.93, 1.07), (0.98, 1.02), (0.98, 1.02), (0.98, 1.02), (0.6, 1.3), (0.005, 0.04), (-0.04, 0.04),
    (0.0, 0.08), (-0.03, 0.03), (-0.03, 0.03), (-0.07, 0.07), (0.5, 0.7), (2.4, 3.4), (0.0, 0.3), (0.0, 0.15),
)  # fmt: skip


def hidden_robot(seed: int) -> HiddenRobot:
    """Draw the robot of a seed."""
    rng = np.random.default_rng([35, seed])
    values = {field.name: float(rng.uniform(*getattr(_LIMITS, field.name))) for field in fields(HiddenRobot)[:-1]}
    for name in ("latency", "scan_age"):
        values[name] = float(np.ceil(values[name] / TICK) * TICK)
    return HiddenRobot(**values)


def in_steps(hidden: HiddenRobot, period: float, scan_period: float) -> HiddenRobot:
    """The robot with latencies in whole control steps, for tasks."""
    latency, age = (round(seconds / period) * period for seconds in (hidden.latency, hidden.scan_age))
    return replace(hidden, latency=latency, scan_age=age, scan_period=scan_period)
