"""The figures of an evaluation, or of a suite, as a table in the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.suite_result import ALL, Figures, SuiteResult
from tb2rl.simulation import ROS, bullet_trouble

_SUITE_COLUMNS = ("", "success", "95 %", "SPL", "time", "m/s", "gap", "failed")
_SUITE_CAPTION = (
    "time: to the goal, over what the shortest way takes at top speed; gap: the least from hull to obstacle [m]; "
    "both: means of the successes"
)


def print_evaluation(evaluation: Evaluation, title: str) -> dict[str, Any]:
    """Print the table of an evaluation and return its summary."""
    console = Console()
    table = Table(title=title, title_justify="left")
    table.add_column(f"{len(evaluation.episodes)} episodes of at most {evaluation.steps} steps")
    table.add_column("value", justify="right")
    table.add_column("", justify="left")
    for *cells, more in evaluation.rows():
        table.add_row(*cells, more if console.encoding.startswith("utf") else more.replace("±", "+/-"))
    console.print(table)
    _say_if_twin(evaluation.simulation)
    return evaluation.summary()


def print_suite(result: SuiteResult) -> None:
    """Print the figures of a suite, a row for each family and one for all."""
    every = result.figures[ALL]
    title, caption = escape(result.title), escape(_SUITE_CAPTION)
    table = Table(title=title, title_justify="left", caption=caption, caption_justify="left")
    table.add_column("worlds")
    for column in _SUITE_COLUMNS:
        table.add_column(column, justify="right")
    for name, figures in result.rows.items():
        table.add_row(name, *_suite_row(figures))
    Console().print(table)
    print(f"in the tenth of the worlds with the longest ways: {_percent(every.longest_tenth_success_rate)} success")
    print(f"endings: {_endings(every.endings)}")
    if every.barn_score is not None:
        print(f"score {every.barn_score:.3f} ({every.barn_formula})")
    _say_if_twin(result.simulation)


def _suite_row(figures: Figures) -> list[str]:
    low, high = figures.success_interval
    return [
        str(figures.worlds),
        _percent(figures.success_rate),
        f"{100 * low:.1f}-{100 * high:.1f}",
        f"{figures.spl:.3f}",
        _number(figures.time_ratio),
        f"{figures.mean_speed:.2f}",
        _number(figures.mean_closest),
        _percent(figures.failed_rate),
    ]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _percent(rate: float) -> str:
    return f"{100 * rate:.1f} %"


def _endings(endings: Mapping[str, int]) -> str:
    return ", ".join(f"{ended} {count}" for ended, count in endings.items())


def _say_if_twin(simulation: str) -> None:
    if simulation == ROS:
        print("driven by a robot with ROS: its way is that of its odometry")
    elif simulation != "bullet":
        trouble = bullet_trouble()
        reason = f", since PyBullet {trouble}" if trouble else ""
        print(f"driven in the fast twin{reason}: these are not PyBullet's figures")
