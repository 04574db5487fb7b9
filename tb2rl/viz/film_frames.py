"""Film frames: an episode at a frame rate of its own, interpolated between control steps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tb2rl.evaluation.moments import Moment
from tb2rl.simulation import InitialState, RobotState
from tb2rl.simulation.obstacles.outlines import X, Y
from tb2rl.tasks import Task

_HOLD = 1.0  # [s] for which the last frame of an episode stays


@dataclass(frozen=True)
class FilmFrame:
    """One instant of an episode; actions, rewards and speeds are those of its control step."""

    initial_state: InitialState  # of the episode, for one environment
    time: float  # since the reset [s]
    pose: np.ndarray  # x [m], y [m], yaw [rad], shape (3,)
    path: Sequence[np.ndarray]  # poses (3,) at the start of this control step and of those before it
    twist: tuple[float, float]  # mean v [m/s], w [rad/s]
    action: np.ndarray
    reward: float
    episode_return: float  # so far
    ended: str | None  # the ending, in frames after the last control step
    failed: bool  # whether the control step ends the episode with a failure
    ranges: np.ndarray | None  # along the laser's beams [m], shape (beams,)
    dynamic_obstacles: np.ndarray | None  # outlines as in `RobotState.dynamic_obstacles`, shape (obstacles, 6)


def film_frames(moments: Iterable[Moment], period: float, rate: float, speed: float = 1.0) -> Iterator[FilmFrame]:
    """Frames of an episode; the last one is repeated for a second.

    Args:
        moments: The control steps.
        period: Of a control step [s].
        rate: Frames a second.
        speed: Playback speed; 1 is real time.
    """
    count = 0
    path: tuple[np.ndarray, ...] = ()
    for moment in moments:
        before, after = moment.before.pose[0], moment.after.pose[0]
        outlines_before, outlines_after = _outlines(moment.before), _outlines(moment.after)
        path = (*path, before)
        final = FilmFrame(
            initial_state=moment.initial_state,
            time=moment.step * period,
            pose=after,
            path=path,
            twist=mean_twist(before, after, period),
            action=moment.action,
            reward=moment.reward,
            episode_return=moment.total,
            ended=moment.info["ended"],
            failed=moment.info["failed"],
            ranges=moment.after.ranges[0],
            dynamic_obstacles=outlines_after,
        )
        while (time := count * speed / rate) < final.time - 1e-9:
            fraction = time / period - (moment.step - 1)
            pose = interpolate_pose(before, after, fraction)
            outlines = _interpolate_outlines(outlines_before, outlines_after, fraction)
            yield replace(final, time=time, pose=pose, ended=None, dynamic_obstacles=outlines)
            count += 1
        if final.ended:
            yield from [final] * round(_HOLD * rate)


def _outlines(robot_state: RobotState) -> np.ndarray | None:
    return None if robot_state.dynamic_obstacles is None else robot_state.dynamic_obstacles[0]


def interpolate_pose(before: np.ndarray, after: np.ndarray, fraction: float) -> np.ndarray:
    """Linear interpolation between two poses (3,), by the shorter turn."""
    difference = after - before
    difference[2] = math.remainder(difference[2], math.tau)
    return before + fraction * difference


def _interpolate_outlines(before: np.ndarray | None, after: np.ndarray | None, fraction: float) -> np.ndarray | None:
    """Outlines (obstacles, 6) with interpolated positions and the orientations of `after`."""
    if before is None or after is None:
        return None
    outlines = after.copy()
    outlines[:, [X, Y]] = (1 - fraction) * before[:, [X, Y]] + fraction * after[:, [X, Y]]
    return outlines


def mean_twist(before: np.ndarray, after: np.ndarray, period: float) -> tuple[float, float]:
    """Mean forward speed v [m/s] and turn rate w [rad/s] between two poses (3,) that are `period` [s] apart."""
    dx, dy, turn = after - before
    turn = math.remainder(turn, math.tau)
    heading = before[2] + turn / 2
    return (dx * math.cos(heading) + dy * math.sin(heading)) / period, turn / period


def goal_of(task: Task, initial_state: InitialState) -> np.ndarray:
    """Goal of the first environment, x, y [m], shape (2,); NaN for a task without a goal."""
    return initial_state.goal[0] if task.goal_task else np.full(2, np.nan)
