"""Tables of evaluations and suite results in the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.suite_result import ALL, Figures, SuiteResult
from tb2rl.simulation import default_physics, find_simulator

_CAPTION = (
    "time: to the goal, divided by the time of the shortest path at top speed; gap: the smallest distance between hull "
    "and obstacle [m]; both: means over the successes"
)


def print_evaluation(evaluation: Evaluation, title: str) -> dict[str, Any]:
    """Print the table of an evaluation and return its summary."""
    console = Console()
    table = Table(title=title, title_justify="left")
    table.add_column(f"{len(evaluation.episodes)} episodes of at most {evaluation.steps} steps")
    table.add_column("value", justify="right")
    table.add_column("")
    for *cells, spread in evaluation.rows():
        table.add_row(*cells, spread if console.encoding.startswith("utf") else spread.replace("±", "+/-"))
    console.print(table)
    _print_simulator(evaluation.simulation)
    return evaluation.summary()


def print_suite(result: SuiteResult) -> None:
    """Print a table with a row for each family of worlds and one for all of them."""
    total = result.figures[ALL]
    table = Table(title=escape(result.title), title_justify="left", caption=escape(_CAPTION), caption_justify="left")
    table.add_column("worlds")
    for column in _suite_row(total):
        table.add_column(column, justify="right")
    for name, figures in result.rows.items():
        table.add_row(name, *_suite_row(figures).values())
    Console().print(table)
    print(f"success in the tenth of the worlds with the longest paths: {100 * total.longest_tenth_success_rate:.1f} %")
    print(f"endings: {', '.join(f'{ended} {count}' for ended, count in total.endings.items())}")
    if total.barn_score is not None:
        print(f"score {total.barn_score:.3f} ({total.barn_formula})")
    _print_simulator(result.simulation)


def _suite_row(figures: Figures) -> dict[str, str]:
    """The cells of a row by their columns."""
    low, high = figures.success_interval
    return {
        "": str(figures.worlds),
        "success": f"{100 * figures.success_rate:.1f} %",
        "95 %": f"{100 * low:.1f}-{100 * high:.1f}",
        "SPL": f"{figures.spl:.3f}",
        "time": "-" if figures.time_ratio is None else f"{figures.time_ratio:.2f}",
        "m/s": f"{figures.mean_speed:.2f}",
        "gap": "-" if figures.mean_closest is None else f"{figures.mean_closest:.2f}",
        "failed": f"{100 * figures.failed_rate:.1f} %",
    }


def _print_simulator(simulation: str) -> None:
    simulator, physics = find_simulator(simulation), default_physics()
    if simulator.is_robot:
        print(f"driven by {simulator.title}: its path is that of its odometry")
    elif not simulator.is_physics:
        trouble = physics.unavailable()
        reason = f", because {physics.title} {trouble}" if trouble else ""
        print(f"driven in the {simulator.title}{reason}: these are not {physics.title}'s results")
