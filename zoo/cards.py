"""What the zoo says of its policies: a card for each, and tables of all."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import jinja2

from tb2rl.zoo import results
from tb2rl.zoo.entry import WORLDS, Entry, other_suite_policies, suite_policies_of

_STARTS_NAMED = 5  # failed episodes on a card


def card(entry: Entry) -> str:
    """The text of a policy's card."""
    driven = entry.suite_policy.summaries if entry.navigates else []
    lines = {"shortfalls": _shortfalls(entry), "failures": [*_failures(entry), *results.failures(driven)]}
    return template("card.md.jinja").render(entry=entry, summaries=driven, results=results, **lines)


def table(built: Sequence[Entry]) -> str:
    """The text of the zoo's README: the results of all policies, in each other's worlds and in suites, too."""
    suites = results.by_suite([*suite_policies_of(built), *other_suite_policies()])
    return template("table.md.jinja").render(entries=built, worlds=WORLDS, suites=suites, results=results)


def overview(built: Sequence[Entry]) -> str:
    """The table of the project's README: a row for each task and world, a column for each agent."""
    agents = list(dict.fromkeys(entry.config.agent_name for entry in built))
    lines = ["| task, world | " + " | ".join(f"`{agent}`" for agent in agents) + " |", "|---" * (len(agents) + 1) + "|"]
    for place, there in groupby(built, key=_place):
        cells = {
            entry.config.agent_name: f"{percent(entry.good_rate)}, {entry.figures['mean_speed']:.2f} m/s"
            for entry in there
        }
        lines.append("| " + " | ".join([f"`{', '.join(place)}`", *(cells.get(agent, "") for agent in agents)]) + " |")
    return "\n".join(lines) + "\n"


def _place(entry: Entry) -> tuple[str, ...]:
    """The task, the world, and the conditions if there are some."""
    return tuple(filter(None, (entry.config.task_name, entry.place, entry.conditions)))


def percent(share: float) -> str:
    """0.994 as 99 %."""
    return f"{100 * share:.0f} %"


def _spaced(number: int) -> str:
    return f"{number:,}".replace(",", " ")


def template(name: str) -> jinja2.Template:
    """A template that stands beside this module."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    env = jinja2.Environment(loader=loader, trim_blocks=True, undefined=jinja2.StrictUndefined)
    env.filters.update(percent=percent, interval=results.interval, spaced=_spaced)
    return env.get_template(name)


def _shortfalls(entry: Entry) -> list[str]:
    """In what a policy is less than the zoo promises, in sentences."""
    speed, lines = entry.speed_share, []
    if entry.good_rate < entry.promised:
        lines.append(
            f"{percent(entry.good_rate)} of its episodes are good, the zoo promises {percent(entry.promised)}."
        )
    if speed < entry.promised_speed:
        promised = percent(entry.promised_speed)
        lines.append(f"it drives at {percent(speed)} of the fastest command's speed, the zoo promises {promised}.")
    return lines


def _failures(entry: Entry) -> list[str]:
    """What a policy fails at, in its own world and in those that it never saw."""
    failed = [episode for episode in entry.figures["each"] if not episode["success"]]
    lines = [f"In its own world: {len(failed)} of {entry.figures['episodes']} episodes."]
    for episode in failed[:_STARTS_NAMED]:
        x, y, yaw = episode["start"]
        lines.append(f"{episode['ended']} after {episode['length']} steps from ({x:.2f} m, {y:.2f} m, {yaw:.2f} rad)")
    for world, figures in entry.elsewhere.items():
        endings = ", ".join(f"{ended} {count}" for ended, count in figures["endings"].items())
        failing, speed = percent(1 - figures[f"{entry.good}_rate"]), figures["mean_speed"]
        lines.append(f"In `{world}`, which it never saw: {failing} of the episodes ({endings}), at {speed:.2f} m/s.")
    return lines
