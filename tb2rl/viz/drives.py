"""The drives of bags that a report shows: where the robot went, how fast, and how near it came to anything."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from tb2rl.deploy.bags.drive import Drive
from tb2rl.rendering.colours import BEAM, FAILED, GOAL, PATH, START
from tb2rl.viz.charts import STYLE, WIDTH, mark, svg, world_figure
from tb2rl.worlds import World

LINES = {"measured": PATH, "commanded": BEAM}  # and their colours
_POINTS = 600  # of a line: a phone has no more to show them
_MARKS = 100  # of one kind in a picture
_MARGIN = 0.5  # [m] around a path


@dataclass(frozen=True)
class DriveSection:
    """What a page says of a drive.

    Attributes:
        drive: It.
        world: The name of the world that it is drawn in; "": in none.
        path: From above.
        speed: Over time, measured and commanded.
        turn: The turn rate, the same way.
        nearest: The shortest range over time; None: there is no scan.
    """

    drive: Drive
    world: str
    path: Markup
    speed: Markup
    turn: Markup
    nearest: Markup | None


def drive_section(drive: Drive, world: World | None = None) -> DriveSection:
    """Draw a drive, in a world if there is one.

    Odometry does not know where in the world it began: such a drive begins at the world's start.
    """
    way, told = drive.trajectory, drive.commands
    return DriveSection(
        drive,
        world.name if world else "",
        _draw_path(drive, world),
        _draw_lines("speed [m/s]", _thinned(way[:, [0, 4]]), _thinned(told[:, [0, 1]])),
        _draw_lines("turn rate [rad/s]", _thinned(way[:, [0, 5]]), _thinned(told[:, [0, 2]])),
        _draw_lines("nearest range [m]", _thinned(drive.nearest, np.min)) if len(drive.nearest) else None,
    )


@matplotlib.rc_context(STYLE)
def _draw_path(drive: Drive, world: World | None) -> Markup:
    path = drive.trajectory[:, 1:3] if world is None or len(drive.truth) else drive.path_from(world.start)
    low, high = path.min(axis=0) - _MARGIN, path.max(axis=0) + _MARGIN
    if world is not None:
        low, high = np.minimum(low, world.bounds[:2]), np.maximum(high, world.bounds[2:])
    bounds = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    floor = World.from_shapes("", start=(0.0, 0.0, 0.0), bounds=bounds)
    figure, (axes,) = world_figure([world.with_places(None, None, bounds) if world else floor])
    axes.plot(*_thinned(path).T, color=PATH, linewidth=1.2, gid="drive")
    mark(axes, [path[0]], s=22, color=START, linewidths=0, zorder=3, gid="start")
    mark(axes, _touches(drive, path), s=28, color=FAILED, marker="x", linewidths=1.4, zorder=4, gid="touches")
    if len(drive.goals) and len(drive.truth):  # it is in the frame of the world, which odometry is not
        star = {"s": 90, "color": GOAL, "marker": "*", "edgecolors": "black", "linewidths": 0.5}
        mark(axes, _few(drive.goals[:, 1:]), zorder=5, gid="goal", **star)
    return svg(figure)


def _touches(drive: Drive, path: np.ndarray) -> np.ndarray:
    """Where it began to touch something: x, y [m], shape (touches, 2)."""
    touched = np.diff(drive.touches[:, 1], prepend=0.0) > 0.0
    times = _few(drive.touches[touched, 0])
    return np.column_stack([np.interp(times, drive.trajectory[:, 0], column) for column in path.T])


def _few(things: np.ndarray) -> np.ndarray:
    """All things, or if they are many evenly some of them."""
    return things[:: 1 + len(things) // _MARKS]


@matplotlib.rc_context(STYLE)
def _draw_lines(label: str, measured: np.ndarray, commanded: np.ndarray | None = None) -> Markup:
    """Lines over time, from rows of time [s] and value."""
    figure = Figure(figsize=(WIDTH, 0.62 * WIDTH), layout="constrained")
    axes = figure.add_subplot(xlabel="time [s]", ylabel=label)
    if commanded is not None:
        axes.plot(*commanded.T, color=LINES["commanded"], linewidth=1.4, drawstyle="steps-post", gid="line-commanded")
    axes.plot(*measured.T, color=LINES["measured"], linewidth=1.4, gid="line-measured")
    axes.grid(axis="y")
    return svg(figure)


def _thinned(rows: np.ndarray, figure: Callable[..., np.ndarray] = np.mean) -> np.ndarray:
    """Rows, or a figure of as many neighbours as leave few enough: their mean, or another."""
    together = -(-len(rows) // _POINTS)
    if together <= 1:
        return rows
    return np.array([figure(part, axis=0) for part in np.array_split(rows, len(rows) // together)])
