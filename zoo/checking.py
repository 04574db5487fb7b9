"""Holding an entry of the zoo against PyBullet and against its own files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tb2rl.core.files import read_text
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.progress import say
from tb2rl.evaluation.statistics import wilson_interval
from tb2rl.zoo.cards import card, percent
from tb2rl.zoo.entry import Entry

_TOLERANCE = 0.02  # of the speed, from one machine to another


def check(entry: Entry, episodes: int) -> list[str]:
    """Evaluate a policy again in its own world; what its card and the new figures do not agree on.

    Args:
        entry: The policy.
        episodes: How many of the standard evaluation, the first ones.
    """
    again = evaluate(entry.folder, episodes=episodes, progress=True).summary()
    rate, speed = again[f"{entry.good}_rate"], again["mean_speed"]
    say(f"{entry.name}: {percent(rate)} good episodes, {speed:.3f} m/s")
    before = entry.figures["each"][:episodes]
    good = sum(each["success"] if entry.good == "success" else not each["failed"] for each in before)
    lowest, _ = wilson_interval(good, len(before))
    speed_before = _speed(before, entry.config.task.control_period)
    wrong = []
    if not entry.is_as_requested:
        wrong.append("it was not trained as its recipe says")
    if read_text(entry.folder / "README.md") != card(entry):
        wrong.append("its card is not what its files say")
    if rate < lowest:
        wrong.append(f"{percent(rate)} good episodes, below the card's interval from {100 * lowest:.1f} %")
    if speed < (1 - _TOLERANCE) * speed_before:
        wrong.append(f"{speed:.3f} m/s, {speed_before:.3f} when the card was written")
    return [f"{entry.name}: {line}" for line in wrong]


def _speed(episodes: Sequence[Mapping[str, Any]], period: float) -> float:
    """Mean speed over episodes as `evaluation.json` has them [m/s]; `period` of a control step [s]."""
    return sum(each["distance"] for each in episodes) / (sum(each["length"] for each in episodes) * period)
