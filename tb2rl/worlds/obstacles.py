"""Distances from points and rays to single boxes and posts, compiled; rows as in `World.boxes` and `World.posts`."""

from __future__ import annotations

import math

import numpy as np

from tb2rl.core.compiled import UNCOUNTED, njit

PARALLEL = 1e-12  # direction components below this count as parallel to a side; avoids 0 / 0


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def squared_gap_to_box(x, y, boxes, k):
    """Squared distance from a point to box `k` [m^2], 0 inside it."""
    east, north = x - boxes[k, 0], y - boxes[k, 1]
    dx = abs(boxes[k, 4] * east + boxes[k, 5] * north) - boxes[k, 2]
    dy = abs(boxes[k, 4] * north - boxes[k, 5] * east) - boxes[k, 3]
    dx, dy = max(dx, 0.0), max(dy, 0.0)
    return dx * dx + dy * dy


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def gap_to_post(x, y, posts, k):
    """Distance from a point to post `k` [m], 0 inside it."""
    east, north = x - posts[k, 0], y - posts[k, 1]
    return max(math.sqrt(east * east + north * north) - posts[k, 2], 0.0)


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def hit_box(x, y, dx, dy, boxes, k):
    """Distance along the unit vector `dx`, `dy` to box `k` [m]: 0 inside it, inf if the ray misses it."""
    cos, sin = boxes[k, 4], boxes[k, 5]
    east, north = boxes[k, 0] - x, boxes[k, 1] - y
    ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
    over_x = 1.0 / (ahead if abs(ahead) > PARALLEL else PARALLEL)
    over_y = 1.0 / (aside if abs(aside) > PARALLEL else PARALLEL)
    mid_x, mid_y = (cos * east + sin * north) * over_x, (cos * north - sin * east) * over_y
    reach_x, reach_y = boxes[k, 2] * abs(over_x), boxes[k, 3] * abs(over_y)
    near, far = max(mid_x - reach_x, mid_y - reach_y, 0.0), min(mid_x + reach_x, mid_y + reach_y)
    return near if far >= near else np.inf


@njit(cache=True, **UNCOUNTED, error_model="numpy", forceinline=True)
def hit_post(x, y, dx, dy, posts, k):
    """Distance along the unit vector `dx`, `dy` to post `k` [m]: 0 inside it, inf if the ray misses it."""
    east, north = posts[k, 0] - x, posts[k, 1] - y
    along, across = east * dx + north * dy, east * dy - north * dx
    half_chord = posts[k, 2] * posts[k, 2] - across * across
    half = math.sqrt(max(half_chord, 0.0))
    return max(along - half, 0.0) if half_chord >= 0.0 and along + half >= 0.0 else np.inf
