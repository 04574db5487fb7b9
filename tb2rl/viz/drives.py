"""Drives from bags on a report's page: path, speeds and nearest range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import matplotlib
import numpy as np
from markupsafe import Markup

from tb2rl.deploy.bags.drive import Drive
from tb2rl.rendering.colours import BEAM, FAILED, PATH, START
from tb2rl.viz.charts import STYLE, chart, mark, mark_goals, svg, world_figure
from tb2rl.worlds import World

LINE_COLOURS = {"measured": PATH, "commanded": BEAM}
_POINTS = 600  # of a line, at most: a phone has no more pixels
_MARKS = 100  # of one kind in a picture, about
_MARGIN = 0.5  # [m] around a path


@dataclass(frozen=True)
class DriveSection:
    """A drive with its charts."""

    drive: Drive
    world: str  # its name; "": none
    path: Markup
    speed: Markup  # measured and commanded
    turn_rate: Markup  # measured and commanded
    nearest: Markup | None  # None: there is no scan


def drive_section(drive: Drive, world: World | None = None) -> DriveSection:
    """Draw a drive, in a world if one is given.

    Odometry has no fixed frame in the world, so its path begins at the world's start.
    """
    measured, commands = drive.trajectory, drive.commands
    return DriveSection(
        drive,
        world.name if world else "",
        _draw_path(drive, world),
        _draw_lines("speed [m/s]", _thinned(measured[:, [0, 4]]), _thinned(commands[:, [0, 1]])),
        _draw_lines("turn rate [rad/s]", _thinned(measured[:, [0, 5]]), _thinned(commands[:, [0, 2]])),
        _draw_lines("nearest range [m]", _thinned(drive.nearest, np.min)) if len(drive.nearest) else None,
    )


@matplotlib.rc_context(STYLE)
def _draw_path(drive: Drive, world: World | None) -> Markup:
    path = drive.trajectory[:, 1:3] if world is None or len(drive.truth) else drive.path_from(world.start)
    low, high = path.min(axis=0) - _MARGIN, path.max(axis=0) + _MARGIN
    if world is None:
        world = World.from_shapes("", start=(0.0, 0.0, 0.0), bounds=(*low.tolist(), *high.tolist()))
    else:
        low, high = np.minimum(low, world.bounds[:2]), np.maximum(high, world.bounds[2:])
    figure, (axes,) = world_figure([world.with_places(None, None, (*low.tolist(), *high.tolist()))])
    axes.plot(*_thinned(path).T, color=PATH, linewidth=1.2, gid="drive")
    mark(axes, [path[0]], s=22, color=START, linewidths=0, zorder=3, gid="start")
    contact_begins = np.diff(drive.touches[:, 1], prepend=0.0) > 0.0
    times = _subset(drive.touches[contact_begins, 0])
    contacts = np.column_stack([np.interp(times, drive.trajectory[:, 0], column) for column in path.T])
    mark(axes, contacts, s=28, color=FAILED, marker="x", linewidths=1.4, zorder=4, gid="contacts")
    if len(drive.goals) and len(drive.truth):  # because goals are in the world's frame
        mark_goals(axes, _subset(drive.goals[:, 1:]), "goal")
    return svg(figure)


def _subset(rows: np.ndarray) -> np.ndarray:
    """All rows, or about `_MARKS` of them at equal distances."""
    return rows[:: 1 + len(rows) // _MARKS]


@matplotlib.rc_context(STYLE)
def _draw_lines(label: str, measured: np.ndarray, commanded: np.ndarray | None = None) -> Markup:
    """Lines over time, from rows of time [s] and value."""
    figure, axes = chart("time [s]", label)
    if commanded is not None:
        axes.step(*commanded.T, where="post", color=LINE_COLOURS["commanded"], linewidth=1.4, gid="line-commanded")
    axes.plot(*measured.T, color=LINE_COLOURS["measured"], linewidth=1.4, gid="line-measured")
    return svg(figure)


def _thinned(rows: np.ndarray, reduce: Callable[..., np.ndarray] = np.mean) -> np.ndarray:
    """At most `_POINTS` rows, each of them reduced from neighbours."""
    neighbours = -(-len(rows) // _POINTS)
    if neighbours <= 1:
        return rows
    return np.array([reduce(part, axis=0) for part in np.array_split(rows, len(rows) // neighbours)])
