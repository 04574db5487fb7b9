"""The page of a calibration: what was predicted and measured, before and after it."""

from dataclasses import dataclass

import matplotlib
import numpy as np
from markupsafe import Markup

from tb2rl.calibration import alignment
from tb2rl.calibration.alignment import START, Alignment, spread_indices
from tb2rl.calibration.calibration import Calibration
from tb2rl.calibration.output import rows
from tb2rl.rendering.colours import BEAM, FAILED, PATH
from tb2rl.viz.charts import STYLE, chart, svg
from tb2rl.viz.page import template

_SECONDS = 40.0  # of the charts of speeds
_SCANS = 60  # that are drawn
_LINE_WIDTHS = 4.0, 2.4, 1.0  # descending, because lines may be the same and the last one is on top
COLOURS = {"measured": PATH, "nominal robot": BEAM, "calibrated robot": FAILED}


@dataclass(frozen=True)
class CalibrationSection:
    """The charts of a drive."""

    name: str
    path: Markup
    speed: Markup
    turn_rate: Markup
    scans: tuple[Markup, Markup] | None  # before and after the calibration


def calibration_page(calibration: Calibration) -> str:
    """The page as HTML."""
    sections = [_section(calibration, index) for index in range(len(calibration.drives))]
    title, table = "Calibration", list(rows(calibration))
    return template("calibration.html").render(title=title, rows=table, sections=sections, colours=COLOURS)


def _section(calibration: Calibration, index: int) -> CalibrationSection:
    drive, fit, parameters = calibration.drives[index], calibration.responses[index], calibration.alignments[index]
    true_scales = np.array([parameters[alignment.DISTANCE], parameters[alignment.TURN]])
    fitted, measured = fit.fitted / true_scales, fit.measured / true_scales
    paths = [integrate(fit.times, each) for each in (measured, fit.nominal, fitted)]
    speeds = [[each[:, k] for each in (measured, fit.nominal, fitted)] for k in (0, 1)]
    shown = fit.times < fit.times[0] + _SECONDS
    scans = None
    if drive.scans is not None:
        start = Alignment(drive, drive.scans, 0.01)
        scans = (
            _draw_scans(start, len(drive.scans.times), START),
            _draw_scans(start, len(drive.scans.times), parameters),
        )
    return CalibrationSection(
        drive.name,
        _draw_lines("x [m]", "y [m]", [path[:, 0] for path in paths], [path[:, 1] for path in paths], equal=True),
        _draw_lines("time [s]", "speed [m/s]", [fit.times[shown]] * 3, [each[shown] for each in speeds[0]]),
        _draw_lines("time [s]", "turn rate [rad/s]", [fit.times[shown]] * 3, [each[shown] for each in speeds[1]]),
        scans,
    )


def integrate(times: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Poses x, y, yaw from (0, 0, 0), shape (times, 3), of a robot with speeds v [m/s], w [rad/s], shape (times, 2)."""
    arcs = 0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times)[:, None]
    yaw = np.concatenate([[0.0], np.cumsum(arcs[:, 1])])
    heading = yaw[:-1] + 0.5 * arcs[:, 1]
    x, y = (np.concatenate([[0.0], np.cumsum(arcs[:, 0] * each(heading))]) for each in (np.cos, np.sin))
    return np.column_stack([x, y, yaw])


@matplotlib.rc_context(STYLE)
def _draw_lines(label_x: str, label_y: str, x: list[np.ndarray], y: list[np.ndarray], equal: bool = False) -> Markup:
    figure, axes = chart(label_x, label_y)
    for (name, colour), each_x, each_y, width in zip(COLOURS.items(), x, y, _LINE_WIDTHS, strict=True):
        step = max(1, len(each_x) // 1500)
        axes.plot(each_x[::step], each_y[::step], color=colour, linewidth=width, gid=f"line-{name.replace(' ', '-')}")
    if equal:
        axes.set_aspect("equal", adjustable="datalim")
    return svg(figure)


@matplotlib.rc_context(STYLE)
def _draw_scans(aligned: Alignment, scan_count: int, parameters: np.ndarray) -> Markup:
    """All readings of some scans in one frame; walls are thin where the parameters are right."""
    points = aligned.points(spread_indices(scan_count, _SCANS), parameters)
    figure, axes = chart("x [m]", "y [m]")
    axes.plot(*points[::7].T, ".", color=PATH, markersize=1.5, rasterized=True, gid="readings")
    axes.set_aspect("equal", adjustable="datalim")
    return svg(figure)
