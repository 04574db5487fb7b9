"""The instants of a drive that a film or the window shows, at a rate of its own between the control steps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tb2rl.evaluation.moments import Moment
from tb2rl.simulation.obstacles.outlines import X, Y

_HOLD = 1.0  # [s] that the end of an episode stays to be seen


@dataclass(frozen=True)
class Shot:
    """An instant of a drive, to be shown."""

    moment: Moment  # the control step that it belongs to
    path: Sequence[np.ndarray]  # poses (3,) since the reset, up to the one that the step began at
    pose: np.ndarray  # x [m], y [m], yaw [rad], shape (3,)
    time: float  # since the reset [s]
    over: bool  # whether the episode is
    dynamic_obstacles: np.ndarray | None = (
        None  # outlines as in `RobotState.dynamic_obstacles`, shape (movers, 6); None: nothing moves
    )


def shots(moments: Iterable[Moment], period: float, rate: float, speed: float = 1.0) -> Iterator[Shot]:
    """Show an episode; its end stays for a while. Between control steps all moves on straight lines.

    Args:
        moments: Its control steps.
        period: Of a control step [s].
        rate: Instants a second.
        speed: How many times as fast as it happened.
    """
    count = 0
    path: tuple[np.ndarray, ...] = ()
    for moment in moments:
        path = (*path, moment.before)
        end = moment.step * period
        while (instant := count * speed / rate) < end - 1e-9:
            share = instant / period - (moment.step - 1)
            pose, dynamic_obstacles = between(moment.before, moment.pose, share), movers_between(moment, share)
            yield Shot(moment, path, pose, instant, over=False, dynamic_obstacles=dynamic_obstacles)
            count += 1
        if moment.info["ended"]:
            yield from [Shot(moment, path, moment.pose, end, True, moment.dynamic_obstacles)] * round(_HOLD * rate)


def between(before: np.ndarray, after: np.ndarray, share: float) -> np.ndarray:
    """The pose (3,) a `share` of the way between two."""
    way = after - before
    way[2] = math.remainder(way[2], math.tau)
    return before + share * way


def movers_between(moment: Moment, share: float) -> np.ndarray | None:
    """The outlines (movers, 6) a `share` of the way through a control step; they look where they look at its end."""
    if moment.dynamic_obstacles_before is None or moment.dynamic_obstacles is None:
        return None
    outlines = moment.dynamic_obstacles.copy()
    outlines[:, [X, Y]] = (1 - share) * moment.dynamic_obstacles_before[:, [X, Y]] + share * moment.dynamic_obstacles[
        :, [X, Y]
    ]
    return outlines


def speeds(before: np.ndarray, after: np.ndarray, period: float) -> tuple[float, float]:
    """Mean forward speed v [m/s] and turn rate w [rad/s] between two poses (3,) that are `period` [s] apart."""
    east, north, turn = after - before
    turn = math.remainder(turn, math.tau)
    heading = before[2] + turn / 2
    return (east * math.cos(heading) + north * math.sin(heading)) / period, turn / period
