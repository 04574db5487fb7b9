"""Colours that tell runs and actions apart; the first ones also for the colour-blind (Okabe and Ito 2008)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

GROUPS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7f7f7f", "#e69f00", "#56b4e9", "#8c564b")
ACTIONS = ("#9ecae9", "#e69f00", "#4b3a8c", "#009e73", "#cc79a7", "#f0e442", "#d55e00", "#6b7280")


def colours(count: int, first: Sequence[str]) -> Sequence[str]:
    """So many different colours: the first ones, or hues all around if these are too few."""
    hues = colormaps["turbo"](np.linspace(0, 1, count))
    return first[:count] if count <= len(first) else [to_hex(hue) for hue in hues]
