"""Replays the commands of a drive in a simulator, to measure how far the simulation is from reality.

The drive is cut into windows. The simulated robot begins each of them at the measured pose, so that the errors of one
window do not add to those of the next.
"""

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tb2rl.core import InputError
from tb2rl.core.values import Pose
from tb2rl.deploy.bags.reading import Drive, moved
from tb2rl.deploy.trained import make_empty_world
from tb2rl.envs.scene import Scene
from tb2rl.robots import Laser
from tb2rl.simulation import InitialState, RobotState, SimulationSpec, SimulatorType
from tb2rl.worlds import World

WINDOW, LEAD = 5.0, 1.0  # [s] of a window, and of the motion before it that brings the simulated robot to its speed
_STEP = 0.05  # [s] of the simulation
_TIMEOUT = 0.6  # [s] after which a base stops without a command
_MAX_OFFSET = math.radians(5)  # [rad] a scanner that is turned by more is not simulated


@dataclass(frozen=True)
class Replay:
    """The windows of a drive, measured and simulated, both from the measured pose at the start of each window."""

    simulation: str  # title of the simulator
    times: np.ndarray  # [s] start of each window, in the time of the drive, shape (windows,)
    paths: np.ndarray  # simulated x, y [m] in the frame of the measured path, shape (windows, steps + 1, 2)
    distances: np.ndarray  # [m] of simulated and measured positions at the ends of the windows, shape (windows,)
    turns: np.ndarray  # [rad] between the two headings there, shape (windows,)
    range_errors: np.ndarray | None  # [m] median difference of the ranges there, (windows,); None: no world or scans

    def __str__(self) -> str:
        turn = math.degrees(np.median(self.turns))
        apart = f"{np.median(self.distances):.3f} m and {turn:.2f} degrees apart after {WINDOW:g} s"
        ranges = "" if self.range_errors is None else f", ranges {np.nanmedian(self.range_errors):.3f} m"
        return f"{apart}{ranges} (medians of {len(self.times)} windows)"


@dataclass(frozen=True)
class _Middle:
    """A `RandomSource` that draws the middle of each range."""

    num_envs: int

    def uniform(self, count: int) -> np.ndarray:
        return np.full((self.num_envs, count), 0.5)


def replay(drive: Drive, scene: Scene, simulator: SimulatorType, world: World | None = None) -> Replay:
    """Drive the commands of a drive in a simulator.

    Args:
        drive: The drive, read with its scans.
        scene: The robot and, by the middles of its variation's ranges, the parameters of the simulation.
        simulator: The simulator.
        world: The world of the drive; None: a floor without obstacles, whose ranges are not compared.

    Raises:
        InputError: If the drive has no commands, or is shorter than a window.
    """
    if not len(drive.commands):
        raise InputError(f"{drive.name} has no commands to drive again")
    poses = _poses(drive, None if world is None or len(drive.truth) else world.start)
    times = np.arange(poses[0, 0], poses[-1, 0], _STEP)
    lead, length = round(LEAD / _STEP), round(WINDOW / _STEP)
    starts = np.arange(0, len(times) - lead - length, length)
    if not len(starts):
        raise InputError(f"{drive.name} lasts {drive.seconds:.1f} s, shorter than a window of {LEAD + WINDOW:g} s")
    measured = np.column_stack([np.interp(times, poses[:, 0], column) for column in poses.T[1:]])
    laser = _laser(drive, scene.robot.laser) if world else None
    laser_in_use = laser or replace(scene.robot.laser, beams=1, field_of_view=0.1)
    floor = world or make_empty_world(*map(tuple, measured[:, :2].tolist()))
    spec = SimulationSpec(scene.robot, laser_in_use, (floor,))
    initial_state = InitialState.default(spec, len(starts))
    middle: Any = _Middle(len(starts))
    scene.task.resolved_variation.vary(initial_state, middle)
    initial_state.pose[:] = measured[starts]
    latency = float(initial_state.records["command_latency"][0]) * scene.task.control_period
    commands = _commands_at(drive, times - latency)
    begins, ends = starts + lead, starts + lead + length
    with closing(simulator.open(spec, len(starts), processes=1)) as simulation:
        *_, reached = _drive(simulation, initial_state, commands, starts, lead)
        # The robot begins at rest, so it does not reach the measured pose; as much farther ahead it does.
        initial_state.pose[:] = moved(np.stack([reached.pose, measured[starts]], axis=1), measured[begins])[:, 1]
        states = _drive(simulation, initial_state, commands, starts, lead + length)
    simulated = np.stack([state.pose if len(drive.truth) else state.odometry for state in states[lead:]], axis=1)
    paths = moved(simulated, measured[begins])
    turns = np.mod(paths[:, -1, 2] - measured[ends, 2] + math.pi, math.tau) - math.pi
    range_errors = _range_errors(drive, times[begins], states[lead:]) if laser else None
    distances = np.hypot(*(paths[:, -1, :2] - measured[ends, :2]).T)
    return Replay(simulator.title, times[begins], paths[:, :, :2], distances, np.abs(turns), range_errors)


def _drive(
    simulation: Any, initial_state: InitialState, commands: np.ndarray, starts: np.ndarray, steps: int
) -> list[RobotState]:
    """The states of robots that get the commands from the indices `starts` on, with the initial ones."""
    initial = simulation.reset(initial_state, np.random.default_rng(0))
    return [initial, *(simulation.step(commands[starts + step], _STEP) for step in range(steps))]


def _poses(drive: Drive, start: Pose | None) -> np.ndarray:
    """Time, x, y and continuous yaw of the drive, moved so that it begins at `start`, shape (messages, 4)."""
    times, x, y, yaw = drive.trajectory[:, :4].T
    poses = np.column_stack([x, y, np.unwrap(yaw)])
    return np.column_stack([times, poses if start is None else moved(poses, np.array(start))])


def _commands_at(drive: Drive, times: np.ndarray) -> np.ndarray:
    """The commands in effect at some times, shape (times, 2); zero before the first, and after a timeout."""
    sent = np.searchsorted(drive.commands[:, 0], times + 1e-6, side="right") - 1
    commands, age = drive.commands[sent, 1:], times - drive.commands[sent, 0]
    return np.where(((sent >= 0) & (age < _TIMEOUT))[:, None], commands, 0.0)


def _laser(drive: Drive, nominal: Laser) -> Laser | None:
    """The laser of the recorded scans; None without scans, or if the scanner is turned."""
    if drive.scans is None or abs(drive.scans.angles[0] + drive.scans.angles[-1]) > _MAX_OFFSET:
        return None
    field = min(float(drive.scans.angles[-1] - drive.scans.angles[0]), math.tau - 1e-3)
    return replace(nominal, beams=len(drive.scans.angles), field_of_view=field)


def _range_errors(drive: Drive, starts: np.ndarray, states: Sequence[RobotState]) -> np.ndarray:
    """Median difference between measured and simulated ranges at the last scan of each window, shape (windows,)."""
    scans: Any = drive.scans
    last = np.maximum(np.searchsorted(scans.times, starts + WINDOW + 1e-6) - 1, 0)
    steps = np.clip(np.rint((scans.times[last] - starts) / _STEP), 0, len(states) - 1).astype(int)
    simulated = np.array([states[step].ranges[window] for window, step in enumerate(steps.tolist())])
    differences = np.abs(scans.ranges[last] - simulated)
    return np.nanmedian(np.where(np.isfinite(differences), differences, np.nan), axis=1)
