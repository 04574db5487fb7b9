"""Results of suites in Markdown: a table for each suite, and table and failures for a policy's card."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

from tb2rl.evaluation.suite_result import ALL, Figures, SuiteSummary
from tb2rl.worlds.suites import SUITES
from tb2rl.zoo.suite_policies import SuitePolicy

_FIGURES = ("longest tenth", "SPL", "time", "m/s", "closest [m]")
Driven = list[tuple[SuitePolicy, SuiteSummary]]


def by_suite(policies: Iterable[SuitePolicy]) -> list[Driven]:
    """The results in each suite, in the order of the suites; other worlds of the same name are another suite."""
    found = defaultdict(list)
    for policy in policies:
        for summary in policy.summaries:
            found[SUITES.index(summary.suite), summary.suite_digest].append((policy, summary))
    return [found[suite] for suite in sorted(found)]


def compared(driven: Driven) -> str:
    """The table of a suite: a row for each policy, with a column for each family if there are several."""
    first = driven[0][1]
    families = [family for family in first.rows if family != ALL]
    scores = ["score"] if first.figures[ALL].barn_formula else []
    rows = [["driver", "guide", "success", "95 % interval", *families, *_FIGURES, *scores]]
    for policy, summary in driven:
        every = summary.figures[ALL]
        each = [_percent(summary.figures[family].success_rate) for family in families]
        score = [f"{every.barn_score:.3f}"] if scores else []
        conditions = ", ".join(filter(None, (summary.guide, *summary.conditions)))
        rows.append([_link(policy), conditions, *_success(every), *each, *_figures(every), *score])
    return _table(rows)


def by_family(driven: Iterable[SuiteSummary]) -> str:
    """The table of a policy: in each suite a row for each family, and one for all."""
    rows = [["suite", "family", "worlds", "success", "95 % interval", *_FIGURES]]
    for summary in driven:
        for family, figures in summary.rows.items():
            rows.append([summary.suite, family, str(figures.worlds), *_success(figures), *_figures(figures)])
    return _table(rows)


def failures(driven: Iterable[SuiteSummary]) -> Iterator[str]:
    """Failures of a policy, a line for each family."""
    for summary in driven:
        for family, figures in summary.families.items():
            endings = ", ".join(f"{ended} {count}" for ended, count in figures.endings.items())
            failing = _percent(1 - figures.success_rate)
            yield f"In suite `{summary.suite}`, `{family}`: {failing} of {figures.worlds} worlds ({endings})."


def interval(ends: Sequence[float]) -> str:
    """(0.963, 1.0) as 96.3 to 100.0 %."""
    return f"{100 * ends[0]:.1f} to {100 * ends[1]:.1f} %"


def _percent(share: float) -> str:
    """0.994 as 99.4 %."""
    return f"{100 * share:.1f} %"


def _success(figures: Figures) -> list[str]:
    return [_percent(figures.success_rate), interval(figures.success_interval)]


def _figures(figures: Figures) -> list[str]:
    numbers = figures.time_ratio, figures.mean_speed, figures.mean_closest
    tenth, spl = _percent(figures.longest_tenth_success_rate), f"{figures.spl:.3f}"
    return [tenth, spl, *("-" if number is None else f"{number:.2f}" for number in numbers)]


def _link(policy: SuitePolicy) -> str:
    """The policy's name, with a link to its card if it has one."""
    return f"[{policy.name}]({policy.name}/README.md)" if policy.is_entry else policy.name


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *body = ("| " + " | ".join(row) + " |" for row in rows)
    return "\n".join([head, "|---" * len(rows[0]) + "|", *body])
