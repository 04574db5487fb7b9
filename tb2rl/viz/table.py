"""Tables of evaluations and suite results in the terminal."""

from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.evaluation.sim_to_sim import SimToSim, describe_place, explain_place
from tb2rl.evaluation.suite_comparison import suite_sentences, suite_title
from tb2rl.evaluation.suites import ALL, SuiteMetrics, SuiteResult
from tb2rl.simulation.simulator import default_physics, find_simulator

_CAPTION = "means over successes: time relative to the shortest path at top speed; gap between hull and obstacles [m]"


def print_evaluation(evaluation: Evaluation, title: str) -> dict[str, Any]:
    """Print the table of an evaluation, whose title names the simulator (not ROS), and return its summary."""
    console, simulator = Console(), find_simulator(evaluation.simulation)
    header = f"{len(evaluation.episodes)} episodes of at most {evaluation.steps} steps"
    title = title if simulator.is_external else f"{title}, {simulator.title}"
    table = Table(header, Column("value", justify="right"), "", title=title, title_justify="left")
    for label, figure, spread in evaluation.rows():
        table.add_row(label, figure, _printable(spread, console))
    console.print(table)
    _print_simulator(evaluation.simulation)
    return evaluation.summary()


def print_sim_to_sim(comparison: SimToSim, title: str) -> None:
    """Print a table with a column for each simulator, and the differences."""
    console, first = Console(), next(iter(comparison.records.values()))
    title = f"{title}, {first['episodes']} episodes of at most {first['steps']} steps"
    table = Table("", *comparison.titles, title=title, title_justify="left")
    for label, cells in comparison.rows:
        table.add_row(escape(label), *(_printable(f"{value} {spread}".strip(), console) for value, spread in cells))
    console.print(table)
    for sentence in comparison.sentences:
        print(sentence)


def _printable(text: str, console: Console) -> str:
    return text if console.encoding.startswith("utf") else text.replace("\u00b1", "+/-")


def print_suite(*results: SuiteResult) -> None:
    """Print a table of a policy's results in one simulator or several: rows for each family of worlds and for all."""
    is_single = len(results) == 1
    names = ("", "success", "95 %", "SPL", "time", "m/s", "gap", "failed")
    columns = [Column(name, justify="right") for name in names]
    if not is_single:  # the same worlds; how episodes ended follows below
        columns = [Column("physics"), *columns[1:-1]]
    table = Table("worlds", *columns, title=escape(suite_title(results)), title_justify="left", caption_justify="left")
    table.caption = escape(_CAPTION)
    for name in results[0].rows:
        for result in results:
            cells = _suite_cells(result.rows[name])
            table.add_row(name, *(cells if is_single else [find_simulator(result.simulation).title, *cells[1:-1]]))
    Console().print(table)
    for result in results:
        _print_suite_totals(result, "" if is_single else f"{find_simulator(result.simulation).title}: ")
    for sentence in suite_sentences(results):
        print(sentence)
    if is_single:
        _print_simulator(results[0].simulation)


def _suite_cells(metrics: SuiteMetrics) -> list[str]:
    rates = metrics.success_rate, *metrics.success_interval, metrics.failed_rate
    success, low, high, failed = (f"{100 * rate:.1f}" for rate in rates)
    means = metrics.time_ratio, metrics.mean_speed, metrics.mean_min_clearance
    mean_texts = ["-" if mean is None else f"{mean:.2f}" for mean in means]
    return [str(metrics.worlds), f"{success} %", f"{low}-{high}", f"{metrics.spl:.3f}", *mean_texts, f"{failed} %"]


def _print_suite_totals(result: SuiteResult, prefix: str) -> None:
    total = result.figures[ALL]
    longest = f"{100 * total.longest_tenth_success_rate:.1f} %"
    print(f"{prefix}success in the tenth of the worlds with the longest paths: {longest}")
    print(f"{prefix}endings: {', '.join(f'{ended} {count}' for ended, count in total.endings.items())}")
    if total.barn_score is not None:
        print(f"{prefix}score {total.barn_score:.3f} ({total.barn_formula})")


def _print_simulator(simulation: str) -> None:
    """Print what a reader of the table has to know about the simulator of its title."""
    simulator, place = find_simulator(simulation), explain_place(simulation)
    if simulator.is_external:
        print(f"evaluated with {simulator.title}; distances are measured by odometry")
    elif not simulator.is_physics:
        print(f"evaluated {place}: these are not {default_physics().title}'s results")
    elif place != describe_place(simulation):
        print(f"evaluated {place}")
