"""The page of a calibration: what was predicted and measured, before and after it."""

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


def calibration_page(calibration: Calibration) -> str:
    """The page as HTML."""
    sections = [(drive.name, _draw_drive(calibration, index)) for index, drive in enumerate(calibration.drives)]
    title, table = "Calibration", list(rows(calibration))
    return template("calibration.html").render(title=title, rows=table, sections=sections, colours=COLOURS)


def _draw_drive(calibration: Calibration, index: int) -> dict[str, Markup]:
    """The charts of a drive, by title."""
    drive, fit, parameters = calibration.drives[index], calibration.responses[index], calibration.alignments[index]
    true_scales = np.array([parameters[alignment.DISTANCE], parameters[alignment.TURN]])
    fitted, measured = fit.fitted / true_scales, fit.measured / true_scales
    speeds = (measured, fit.nominal, fitted)
    paths = _draw_lines("x [m]", "y [m]", [integrate(fit.times, each)[:, :2] for each in speeds], equal=True)
    charts = {"Path, predicted by the commands alone": paths}
    shown = fit.times < fit.times[0] + _SECONDS
    for column, (title, label) in enumerate((("Speed", "speed [m/s]"), ("Turn rate", "turn rate [rad/s]"))):
        lines = [np.column_stack([fit.times, each[:, column]])[shown] for each in speeds]
        charts[title] = _draw_lines("time [s]", label, lines)
    if drive.scans is not None:
        aligned = Alignment(drive, drive.scans, 0.01)
        for title, values in (("before", START), ("after", parameters)):
            charts[f"Scans {title} the calibration"] = _draw_scans(aligned, len(drive.scans.times), values)
    return charts


def integrate(times: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Poses x, y, yaw from (0, 0, 0), shape (times, 3), of a robot with speeds v [m/s], w [rad/s], shape (times, 2)."""
    arcs = 0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times)[:, None]
    yaw = np.concatenate([[0.0], np.cumsum(arcs[:, 1])])
    heading = yaw[:-1] + 0.5 * arcs[:, 1]
    x, y = (np.concatenate([[0.0], np.cumsum(arcs[:, 0] * each(heading))]) for each in (np.cos, np.sin))
    return np.column_stack([x, y, yaw])


@matplotlib.rc_context(STYLE)
def _draw_lines(label_x: str, label_y: str, lines: list[np.ndarray], equal: bool = False) -> Markup:
    """Lines through points, each of shape (points, 2)."""
    figure, axes = chart(label_x, label_y)
    for (name, colour), points, width in zip(COLOURS.items(), lines, _LINE_WIDTHS, strict=True):
        step, gid = max(1, len(points) // 1500), f"line-{name.replace(' ', '-')}"
        axes.plot(*points[::step].T, color=colour, linewidth=width, gid=gid)
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
