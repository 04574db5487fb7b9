"""What one person does because of another one, compiled.

Moussaid et al. 2009, "Experimental study of the behavioural mechanisms underlying self-organization in human crowds".
"""

from __future__ import annotations

import math

from tb2rl.core.compiled import UNCOUNTED, njit

GAMMA, LAMBDA, N_TURN, N_SLOW = 0.35, 2.0, 2.0, 3.0  # as in the article


@njit(cache=True, **UNCOUNTED, error_model="numpy")
def social_force(east, north, faster_east, faster_north):
    """What one person does because of another one, over the strength of the force: it slows down and turns aside.

    Args:
        east, north: Where the other one is, from here [m].
        faster_east, faster_north: Velocity of this one less that of the other [m/s].
    """
    distance = math.sqrt(east * east + north * north)
    if distance < 1e-9:
        return 0.0, 0.0
    towards_x, towards_y = east / distance, north / distance
    tx, ty = LAMBDA * faster_east + towards_x, LAMBDA * faster_north + towards_y
    size = math.sqrt(tx * tx + ty * ty)
    if size < 1e-9:
        return 0.0, 0.0
    tx, ty, reach = tx / size, ty / size, GAMMA * size
    angle = math.atan2(tx * towards_y - ty * towards_x, tx * towards_x + ty * towards_y)
    slow = -math.exp(-distance / reach - (N_SLOW * reach * angle) ** 2)
    turn = -math.exp(-distance / reach - (N_TURN * reach * angle) ** 2) if angle != 0.0 else 0.0
    turn = math.copysign(turn, -angle)
    return slow * tx - turn * ty, slow * ty + turn * tx
