"""Pages of the zoo: a card for each policy, and tables of all policies."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import jinja2

from tb2rl.evaluation.sim_to_sim import describe_place
from tb2rl.evaluation.suite_comparison import suite_differences, suite_sentences
from tb2rl.simulation import find_simulator
from tb2rl.worlds.suites import SUITES
from tb2rl.zoo.entry import WORLDS, Entry, navigating_policies, policies_of_suites_yaml


def card(entry: Entry) -> str:
    """Card (README) of a policy."""
    results = entry.suite_policy.summaries if entry.navigates else []
    return template("card.md.jinja").render(entry=entry, suites=results)


def table(built_entries: Sequence[Entry]) -> str:
    """README of the zoo: results of all policies in their own worlds, in unseen worlds and in suites."""
    results = defaultdict(list)  # by suite and digest: suites of the same name may have different worlds
    for policy in (*navigating_policies(built_entries), *policies_of_suites_yaml()):
        for summaries in policy.summaries:
            first = summaries[0]
            results[SUITES.index(first.suite), first.suite_digest].append((policy, summaries))
    suites = [results[key] for key in sorted(results)]
    records = [entry.sim_to_sim for entry in built_entries if entry.sim_to_sim]
    others = list(dict.fromkeys(name for each in records for name in each.differences))
    return template("table.md.jinja").render(entries=built_entries, worlds=WORLDS, suites=suites, others=others)


def overview(built_entries: Sequence[Entry]) -> str:
    """Table of the page on evaluation: a row for each combination of task, world and conditions, a column per agent."""
    rows = defaultdict[str, dict[str, Entry]](dict)
    for entry in built_entries:
        title = filter(None, (entry.config.task_name, entry.config.scene.worlds_title, entry.conditions))
        rows[", ".join(title)][entry.config.agent_name] = entry
    agents = dict.fromkeys(entry.config.agent_name for entry in built_entries)
    return template("overview.md.jinja").render(rows=rows, agents=agents)


def template(name: str) -> jinja2.Template:
    """Load a template of this folder."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    env = jinja2.Environment(loader=loader, trim_blocks=True, undefined=jinja2.StrictUndefined)
    env.filters.update(
        percent=percent,
        interval=_interval,
        spaced=lambda number: f"{number:,}".replace(",", " "),
        place=describe_place,
        title=lambda simulation: find_simulator(simulation).title,
        points=lambda difference: f"{100 * difference:z.1f}",
        suite_differences=suite_differences,
        suite_sentences=suite_sentences,
    )
    return env.get_template(name)


def percent(rate: float, decimals: int = 0) -> str:
    """Format 0.994 as "99 %"."""
    return f"{100 * rate:.{decimals}f} %"


def _interval(bounds: Sequence[float]) -> str:
    """Format (0.963, 1.0) as "96.3 to 100.0 %"."""
    return f"{100 * bounds[0]:.1f} to {100 * bounds[1]:.1f} %"
