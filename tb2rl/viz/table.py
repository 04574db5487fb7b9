"""Tables of evaluations and suite results in the terminal."""

from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.suites import ALL, SuiteResult
from tb2rl.simulation.simulator import default_physics, find_simulator

_CAPTION = "means over successes: time relative to the shortest path at top speed; gap between hull and obstacles [m]"


def print_evaluation(evaluation: Evaluation, title: str) -> dict[str, Any]:
    """Print the table of an evaluation and return its summary."""
    console = Console()
    header = f"{len(evaluation.episodes)} episodes of at most {evaluation.steps} steps"
    table = Table(header, Column("value", justify="right"), "", title=title, title_justify="left")
    for label, figure, spread in evaluation.rows():
        table.add_row(label, figure, spread if console.encoding.startswith("utf") else spread.replace("±", "+/-"))
    console.print(table)
    _print_simulator(evaluation.simulation)
    return evaluation.summary()


def print_suite(result: SuiteResult) -> None:
    """Print a table with a row for each family of worlds and a row for all worlds."""
    columns = [Column(name, justify="right") for name in ("", "success", "95 %", "SPL", "time", "m/s", "gap", "failed")]
    table = Table("worlds", *columns, title=escape(result.title), title_justify="left", caption_justify="left")
    table.caption = escape(_CAPTION)
    for name, metrics in result.rows.items():
        rates = metrics.success_rate, *metrics.success_interval, metrics.failed_rate
        success, low, high, failed = (f"{100 * rate:.1f}" for rate in rates)
        means = metrics.time_ratio, metrics.mean_speed, metrics.mean_min_clearance
        mean_texts = ["-" if mean is None else f"{mean:.2f}" for mean in means]
        texts = [f"{success} %", f"{low}-{high}", f"{metrics.spl:.3f}", *mean_texts, f"{failed} %"]
        table.add_row(name, str(metrics.worlds), *texts)
    Console().print(table)
    total = result.figures[ALL]
    print(f"success in the tenth of the worlds with the longest paths: {100 * total.longest_tenth_success_rate:.1f} %")
    print(f"endings: {', '.join(f'{ended} {count}' for ended, count in total.endings.items())}")
    if total.barn_score is not None:
        print(f"score {total.barn_score:.3f} ({total.barn_formula})")
    _print_simulator(result.simulation)


def _print_simulator(simulation: str) -> None:
    simulator, physics = find_simulator(simulation), default_physics()
    if simulator.is_external:
        print(f"evaluated with {simulator.title}; distances are measured by odometry")
    elif not simulator.is_physics:
        problem = physics.unavailable()
        reason = f", because {physics.title} {problem}" if problem else ""
        print(f"evaluated in the {simulator.title}{reason}: these are not {physics.title}'s results")
