"""The figures of an evaluation as a table in the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from tb2rl.judging.evaluation import Evaluation

_MEANS = (("distance", "m"), ("return", ""), ("length", "steps"))  # figures and their units


def print_evaluation(evaluation: Evaluation, title: str) -> dict[str, Any]:
    """Print the table of an evaluation and return its summary."""
    summary = evaluation.summary()
    table = Table(title=title, title_justify="left")
    table.add_column(f"{summary['episodes']} episodes of at most {evaluation.steps} steps")
    table.add_column("value", justify="right")
    table.add_column("", justify="left")
    table.add_row("failure-free", *_rate(summary, "failure_free"))
    if evaluation.task.goal_task:
        table.add_row("goal reached", *_rate(summary, "success"))
    for name, unit in _MEANS:
        table.add_row(name, f"{summary[f'mean_{name}']:.1f}", f"± {summary[f'std_{name}']:.1f} {unit}".rstrip())
    table.add_row("speed", f"{summary['mean_speed']:.3f}", "m/s")
    table.add_row("visited", f"{summary['median_squares']:g}", "squares of 1 m (median)")
    table.add_row("endings", "", ", ".join(f"{ended} {count}" for ended, count in summary["endings"].items()))
    Console().print(table)
    if evaluation.simulation != "bullet":
        print("driven in the fast twin, since PyBullet is not installed: these are not PyBullet's figures")
    return summary


def _rate(summary: dict[str, Any], name: str) -> tuple[str, str]:
    low, high = summary[f"{name}_interval"]
    return f"{100 * summary[f'{name}_rate']:.1f} %", f"95 % interval {100 * low:.1f} to {100 * high:.1f} %"
