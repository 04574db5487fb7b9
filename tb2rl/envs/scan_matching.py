"""Localisation without a given map: odometry, corrected by what the laser has seen before.

Scans are matched with Gaussian distributions of the mapped points (Biber and Straßer 2003, "The normal distributions
transform: a new approach to laser scan matching"). What the matching corrects again and again is a systematic error of
the odometry or of the laser's mounting, which is estimated, too, so that a small correction is enough.
"""

import math

from tb2rl.core.compiled import njit
from tb2rl.worlds.floor import CELL_SIZE

POINT_UNIT = 0.5 * CELL_SIZE / 127  # [m] of the stored offsets of points from the centres of their cells
# Columns of the estimated errors: of distances and of turns by odometry, as shares (true / measured - 1); yaw of the
# laser in the robot's frame [rad]; and the distance driven straight so far [m], after which the estimates change less.
DISTANCE, TURN, MOUNT_YAW, DRIVEN = range(4)
NUM_ERRORS = 4
_LEARNING_DISTANCE = 3.0  # [m] after which an estimate changes half as fast
_LEARNING_RATE = 0.2  # share of a systematic error by which a step changes its estimate at the start
_STRAIGHT_TURN = 0.05  # [rad] in a step; above it, distances and the mounting are not estimated
_LEAST_DISTANCE, _LEAST_TURN = 0.03, 0.05  # [m], [rad] in a step; smaller motions tell little about the errors
_POSITION_DRIFT, _HEADING_DRIFT = 0.05, 0.02  # deviation of odometry per metre [m], and per radian [rad]
_LEAST_DEVIATION = 5e-4  # [m], [rad] of odometry in each step
_POINT_DEVIATION = 0.02  # [m] of a point, in addition to that of the mapped points around it
_OUTLIER = 4.0  # squared distance, in deviations, at which a point has a quarter of its weight
_ITERATIONS, _LAST_CHANGE = 4, 1e-4  # largest number; and sum of changes [m], [rad] below which no more are needed
_MIN_POINTS = 3  # mapped points around the end of a beam for a distribution


@njit(cache=True)
def track(pose, errors, before, after, *scan_and_map):
    """Update the estimates of a pose and of systematic errors after a control step, in place.

    Args:
        pose: x, y, yaw of the laser before the step, shape (3,).
        errors: Estimated errors, shape (`NUM_ERRORS`,).
        before, after: Poses by odometry, shape (3,).
        scan_and_map: Arguments of `_match`.
    """
    dx, dy, turn = after[0] - before[0], after[1] - before[1], after[2] - before[2]
    turn -= math.tau * math.floor((turn + math.pi) / math.tau)
    distance, scale, rotation = math.hypot(dx, dy), 1.0 + errors[DISTANCE], pose[2] - errors[MOUNT_YAW] - before[2]
    cos, sin = scale * math.cos(rotation), scale * math.sin(rotation)
    x, y, yaw = pose[0] + cos * dx - sin * dy, pose[1] + sin * dx + cos * dy, pose[2] + (1.0 + errors[TURN]) * turn
    position_deviation = _LEAST_DEVIATION + _POSITION_DRIFT * distance
    heading_deviation = _LEAST_DEVIATION + _HEADING_DRIFT * abs(turn)
    weights = position_deviation**-2, heading_deviation**-2
    pose[0], pose[1], pose[2] = _match((x, y, yaw), weights, *scan_and_map)
    dx, dy, rate = pose[0] - x, pose[1] - y, _LEARNING_RATE / (1.0 + errors[DRIVEN] / _LEARNING_DISTANCE)
    if abs(turn) < _STRAIGHT_TURN:
        share, cos, sin = rate * distance / (distance**2 + _LEAST_DISTANCE**2), math.cos(yaw), math.sin(yaw)
        errors[DISTANCE] += share * (cos * dx + sin * dy)
        errors[MOUNT_YAW] -= share * (cos * dy - sin * dx)
        errors[DRIVEN] += distance
    errors[TURN] += rate * turn / (turn**2 + _LEAST_TURN**2) * (pose[2] - yaw)


@njit(cache=True)
def _match(predicted, weights, ranges, angles, max_range, grid, hits, points):
    """Correct a predicted pose by Gauss-Newton iterations, and return it.

    Args:
        predicted: x, y, yaw.
        weights: Of the predicted position [1/m^2] and of the yaw [1/rad^2].
        ranges, angles: Of the beams [m], [rad], shape (beams,).
        max_range: Longest range that is matched [m].
        grid, hits, points: The map, see `tb2rl.envs.occupancy_mapper`.
    """
    x, y, yaw = predicted
    for _ in range(_ITERATIONS):
        # The equations `[[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]] @ change = [fx, fy, ft]`.
        xx, xy, xt, yy, yt, tt = weights[0], 0.0, 0.0, weights[0], 0.0, weights[1]
        fx, fy, ft = xx * (predicted[0] - x), yy * (predicted[1] - y), tt * (predicted[2] - yaw)
        for beam in range(ranges.size):
            if ranges[beam] > max_range:
                continue
            ahead, left = ranges[beam] * math.cos(yaw + angles[beam]), ranges[beam] * math.sin(yaw + angles[beam])
            count, mean_x, mean_y, cxx, cxy, cyy = _distribution(x + ahead, y + left, grid, hits, points)
            if count == 0:
                continue
            cxx, cyy = cxx + _POINT_DEVIATION**2, cyy + _POINT_DEVIATION**2
            determinant = cxx * cyy - cxy * cxy
            axx, axy, ayy = cyy / determinant, -cxy / determinant, cxx / determinant  # inverse of the covariance
            dx, dy = mean_x - x - ahead, mean_y - y - left
            bx, by = axx * dx + axy * dy, axy * dx + ayy * dy
            weight = 1.0 / (1.0 + (dx * bx + dy * by) / _OUTLIER) ** 2
            ax, ay = axy * ahead - axx * left, ayy * ahead - axy * left  # the end turns in the direction (-left, ahead)
            xx, xy, yy = xx + weight * axx, xy + weight * axy, yy + weight * ayy
            xt, yt, tt = xt + weight * ax, yt + weight * ay, tt + weight * (ahead * ay - left * ax)
            fx, fy, ft = fx + weight * bx, fy + weight * by, ft + weight * (ahead * by - left * bx)
        change_x, change_y, change = _solve(xx, xy, xt, yy, yt, tt, fx, fy, ft)
        x, y, yaw = x + change_x, y + change_y, yaw + change
        if abs(change_x) + abs(change_y) + abs(change) < _LAST_CHANGE:
            break
    return x, y, yaw


@njit(cache=True)
def _solve(xx, xy, xt, yy, yt, tt, fx, fy, ft):
    """Solve three symmetric equations by Cramer's rule."""
    ax, ay, at = yy * tt - yt * yt, xt * yt - xy * tt, xy * yt - xt * yy
    by, bt, ct = xx * tt - xt * xt, xy * xt - xx * yt, xx * yy - xy * xy
    determinant = xx * ax + xy * ay + xt * at
    x, y, t = ax * fx + ay * fy + at * ft, ay * fx + by * fy + bt * ft, at * fx + bt * fy + ct * ft
    return x / determinant, y / determinant, t / determinant


@njit(cache=True)
def _distribution(x, y, grid, hits, points):
    """Number, mean and covariance (xx, xy, yy) of the mapped points in the nine cells around a position.

    All are 0 at the border of the map, and with fewer than `_MIN_POINTS` points.
    """
    row, column = round((y - grid[3]) / CELL_SIZE), round((x - grid[2]) / CELL_SIZE)
    if not (0 < row < hits.shape[0] - 1 and 0 < column < hits.shape[1] - 1):
        return 0, 0.0, 0.0, 0.0, 0.0, 0.0
    count, sx, sy, sxx, sxy, syy = 0, 0.0, 0.0, 0.0, 0.0, 0.0  # sums, relative to the centre of the cell
    for r in range(row - 1, row + 2):
        for c in range(column - 1, column + 2):
            if hits[r, c] > 0:
                dx = (c - column) * CELL_SIZE + POINT_UNIT * points[r, c, 0]
                dy = (r - row) * CELL_SIZE + POINT_UNIT * points[r, c, 1]
                count, sx, sy = count + 1, sx + dx, sy + dy
                sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
    if count < _MIN_POINTS:
        return 0, 0.0, 0.0, 0.0, 0.0, 0.0
    mx, my = sx / count, sy / count
    cxx, cxy, cyy = sxx / count - mx * mx, sxy / count - mx * my, syy / count - my * my
    return count, grid[2] + column * CELL_SIZE + mx, grid[3] + row * CELL_SIZE + my, cxx, cxy, cyy
