"""The report's charts: learning curves, and what happened where in a world; SVG in which text is text.

Nothing that a user named stands in a chart: names belong to the page around it, which escapes them.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import EngFormatter, FuncFormatter, PercentFormatter

from tb2rl.evaluation.evaluation import Episode, Evaluation
from tb2rl.rendering.colours import FAILED, FLOOR, GOAL, MOVER, PATH, START, WALL
from tb2rl.tasks.outcome import OBSTACLE_COLLISION
from tb2rl.viz.curves import Curve, Family
from tb2rl.viz.pictures import goals_of
from tb2rl.worlds import World
from tb2rl.worlds.world import box_polygons

WIDTH = 4.2  # [in] a phone shows it nearly as large, so its text stays readable
_DOTS = 120  # [1/in] of what is drawn as pixels: thousands of path segments would be megabytes as SVG
_FEW = 30  # points that are marked one by one
_WORLDS, _COLUMNS = 12, 3  # that a picture shows of many, and how many of them stand beside each other
_CELL, _CELLS = 0.1, 150  # [m] side of a cell of the heat map, and how many stand beside each other at most
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "tb2rl",  # the same chart gives the same file
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.use_mathtext": False,
    "text.parse_math": False,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "grid.color": "#dddddd",
}


@matplotlib.rc_context(STYLE)
def draw_curves(families: Sequence[Family], label: str, rate: bool) -> Markup:
    """Learning curves: of several seeds thin lines, their mean and its interval; `rate` for values from 0 to 1."""
    figure = Figure(figsize=(WIDTH, 0.62 * WIDTH), layout="constrained")
    axes = figure.add_subplot(xlabel="control steps", ylabel=label)
    for i, family in enumerate(families):
        _draw_family(axes, family, i)
    axes.grid(axis="y")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.set_xlim(left=0)
    if rate:
        axes.set_ylim(-0.03, 1.03)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=" %"))
    return svg(figure)


def _draw_family(axes: Axes, family: Family, number: int) -> None:
    mean, colour = family.mean, family.colour
    if len(family.curves) > 1:
        for j, curve in enumerate(map(Curve.thinned, family.curves)):
            axes.plot(curve.steps, curve.values, color=colour, linewidth=0.7, alpha=0.5, gid=f"seed-{number}-{j}")
        low, high = family.interval.T
        axes.fill_between(mean.steps, low, high, color=colour, alpha=0.2, linewidth=0, gid=f"interval-{number}")
    marker = "." if len(mean.steps) <= _FEW else ""
    axes.plot(mean.steps, mean.values, color=colour, linewidth=1.8, marker=marker, gid=f"mean-{number}")


@matplotlib.rc_context(STYLE)
def draw_ways(evaluation: Evaluation) -> Markup:
    """The paths of episodes in their worlds, a dot at each start and a cross at the end of each that failed.

    The cross has another colour where the robot touched something that moves; paths of such things are faint.

    Each world has a picture of its own; where there are many, see `shown_worlds`.
    """
    scene, together = evaluation.scene, shown_worlds(evaluation)
    figure, each = world_figure([scene.spec.worlds[world] for world in together])
    for axes, (world, episodes) in zip(each, together.items(), strict=True):
        paths, own = [episode.path for episode in episodes], f"-{world}" * (len(together) > 1)
        axes.add_collection(LineCollection(paths, colors=PATH, linewidths=0.6, alpha=0.3, rasterized=True))
        mark(axes, [path[0] for path in paths], s=9, color=START, linewidths=0, zorder=3, gid=f"starts{own}")
        for group in scene.spec.dynamic_obstacles_in(world):
            axes.plot(*np.reshape(group.route, (-1, 2)).T, color=MOVER, linewidth=1.2, alpha=0.3)
        run_into = [episode.path[-1] for episode in episodes if episode.ended == OBSTACLE_COLLISION]
        mark(axes, run_into, s=22, color=MOVER, marker="x", linewidths=1.2, zorder=4, gid=f"run-into{own}")
        failures = [episode.path[-1] for episode in episodes if episode.failed and episode.ended != OBSTACLE_COLLISION]
        mark(axes, failures, s=22, color=FAILED, marker="x", linewidths=1.2, zorder=4, gid=f"failures{own}")
        goals, star = goals_of(scene, world, episodes), {"s": 90, "marker": "*", "edgecolors": "black"}
        mark(axes, goals, **star, color=GOAL, linewidths=0.5, zorder=5, gid=f"goal{own}")
    return svg(figure)


def shown_worlds(evaluation: Evaluation) -> dict[int, list[Episode]]:
    """The episodes by the index of their world, of which those come first where one failed; of many worlds some."""
    together: dict[int, list[Episode]] = {}
    for episode in evaluation.episodes:
        together.setdefault(episode.world, []).append(episode)
    ordered = sorted(together.items(), key=lambda item: not any(episode.failed for episode in item[1]))
    return dict(ordered[:_WORLDS])


@matplotlib.rc_context(STYLE)
def draw_time(evaluation: Evaluation) -> Markup:
    """How much of the time of all episodes was spent in each cell of the world."""
    figure, (axes,) = world_figure([evaluation.scene.world])
    shares, (left, right, bottom, top) = time_shares(evaluation)
    largest = shares.max() or 1.0  # 0: the robots were out of the world's bounds at all times
    image = axes.imshow(
        np.ma.masked_equal(shares, 0.0).T,
        origin="lower",
        extent=(left, right, bottom, top),
        cmap="YlGnBu",
        norm=LogNorm(largest / 1000, largest),
        interpolation="nearest",
    )
    figure.set_figheight(figure.get_figheight() + 0.5)
    bar = figure.colorbar(image, ax=axes, location="bottom", aspect=40, shrink=0.9, format=FuncFormatter(_as_percent))
    bar.outline.set_visible(False)
    return svg(figure)


def time_shares(evaluation: Evaluation) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """Share of the time in each cell, shape (columns, rows), and the rectangle that the cells fill.

    The rectangle is x from, x to, y from, y to [m].
    """
    x0, y0, x1, y1 = evaluation.scene.world.bounds
    points = np.concatenate([episode.path[1:] for episode in evaluation.episodes])
    side = max(_CELL, (x1 - x0) / _CELLS, (y1 - y0) / _CELLS)
    columns, rows = int(np.ceil((x1 - x0) / side)), int(np.ceil((y1 - y0) / side))
    right, top = x0 + columns * side, y0 + rows * side
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=(columns, rows), range=[(x0, right), (y0, top)])
    return counts / len(points), (x0, right, y0, top)


def _as_percent(share: float, _: int | None) -> str:
    return f"{100 * share:g} %"


def world_figure(worlds: Sequence[World]) -> tuple[Figure, list[Axes]]:
    """A figure with the walls of each of some worlds."""
    columns = min(len(worlds), _COLUMNS)
    rows = math.ceil(len(worlds) / columns)
    x0, y0, x1, y1 = worlds[0].bounds
    height = WIDTH / columns * min((y1 - y0) / (x1 - x0), 1.4)
    figure = Figure(figsize=(WIDTH, rows * max(height, 0.4 * WIDTH / columns)), layout="constrained")
    return figure, [_draw_world(figure, (rows, columns, i + 1), world) for i, world in enumerate(worlds)]


def _draw_world(figure: Figure, place: tuple[int, int, int], world: World) -> Axes:
    """Axes in a place of the figure, with what stands in the world; scales only where it is alone."""
    x0, y0, x1, y1 = world.bounds
    axes = figure.add_subplot(*place, aspect="equal", facecolor=FLOOR)
    if place[:2] == (1, 1):
        axes.set(xlabel="x [m]", ylabel="y [m]")
    else:
        axes.xaxis.set_visible(False)
        axes.yaxis.set_visible(False)
    axes.set(xlim=(x0, x1), ylim=(y0, y1))
    axes.spines[:].set_visible(False)
    walls = [Polygon(np.array(box.exterior.coords)) for box in box_polygons(world.boxes)]
    posts = [Circle((x, y), radius) for x, y, radius in world.posts]
    axes.add_collection(PatchCollection([*walls, *posts], facecolor=WALL, linewidth=0, zorder=2))
    return axes


def mark(axes: Axes, points: Sequence[Any] | np.ndarray, **look: Any) -> None:
    """A mark at each point (x, y) [m]."""
    x, y = np.reshape(points, (-1, 2)).T
    axes.scatter(x, y, **look)


def svg(figure: Figure) -> Markup:
    """The figure as an element of a page: without the header of a file."""
    buffer = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(buffer, format="svg", dpi=_DOTS, metadata=nothing)
    text = buffer.getvalue()
    return Markup(text[text.index("<svg") :])


def with_own_ids(picture: Markup, number: int) -> Markup:
    """The picture with ids that no other `number` has: on a page they would be those of all charts."""
    return Markup(re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>chart-{number}-", str(picture)))
