"""The work of the command `tb2rl.report`: a page of runs, suite results and bags."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from tb2rl.core.errors import InputError
from tb2rl.core.files import parse_yaml, write_text
from tb2rl.core.values import Worlds, checked
from tb2rl.deploy.bags.reading import is_bag, read_drive
from tb2rl.deploy.bags.topics import parse_topics
from tb2rl.envs.worlds import find_worlds
from tb2rl.evaluation.progress import progress as progress_bar
from tb2rl.evaluation.reliable import Estimate
from tb2rl.evaluation.suite_result import kept_result
from tb2rl.viz.comparison import compare, comparison_page, read_compared_runs
from tb2rl.viz.drives import DriveSection, drive_section
from tb2rl.viz.page import page
from tb2rl.viz.run_views import display_names, group_runs, read_run_view, run_folders
from tb2rl.viz.suites import result_files, suite_section


def run(arguments: argparse.Namespace) -> None:
    """Write the page and print its path."""
    if arguments.compare:
        _compare(arguments)
        return
    bags = [reference for reference in arguments.runs if is_bag(Path(reference))]
    files = [reference for reference in arguments.runs if reference not in bags and Path(reference).is_file()]
    folders = run_folders([reference for reference in arguments.runs if reference not in [*bags, *files]])
    out = _page_file(arguments)
    drives = _drive_sections(arguments, [Path(bag) for bag in dict.fromkeys(bags)])
    results = [(file, kept_result(file)) for file in result_files(map(Path, files), folders)]
    named = list(zip(folders, display_names(folders), strict=True))
    bar = progress_bar(named, "reading", "run")
    groups = group_runs([read_run_view(folder, name, progress=True, trust=arguments.trust) for folder, name in bar])
    suites = [suite_section(file, result, progress=True) for file, result in results]
    text = page(groups, suites, drives, progress=True)
    _write(out, text)
    counts = {"run": len(folders), "suite": len(results), "drive": len(drives)}
    content = ", ".join(f"{count} {name}{'s' * (count > 1)}" for name, count in counts.items() if count)
    print(f"{out}: {content}, {len(text.encode()) / 1e6:.1f} MB")


def _compare(arguments: argparse.Namespace) -> None:
    """Compare two folders of runs, print the verdicts and write the page."""
    if len(arguments.runs) != 2 or arguments.topics or arguments.world:
        raise InputError("--compare takes two folders of runs, without --topics and --world")
    ones, others = ({folder.resolve() for folder in run_folders([reference])} for reference in arguments.runs)
    if ones & others:
        raise InputError(f"--compare takes different runs, and {min(ones & others)} is on both sides")
    out = _page_file(arguments)
    one, other = (read_compared_runs(reference, arguments.trust) for reference in arguments.runs)
    comparisons = compare(one, other)
    for each in comparisons:
        print(f"{each.title}: {_percent(each.middles[0])} and {_percent(each.middles[1])}. {each.verdict}")
    _write(out, comparison_page(one, other, comparisons))
    print(out)


def _percent(estimate: Estimate) -> str:
    return f"{100 * estimate.value:.1f} % ({100 * estimate.low:.1f} to {100 * estimate.high:.1f} %)"


def _write(out: Path, text: str) -> None:
    try:
        write_text(out, text)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror}") from None


def _drive_sections(arguments: argparse.Namespace, bags: list[Path]) -> list[DriveSection]:
    topics = parse_topics(arguments.topics)
    if (topics or arguments.world) and not bags:
        raise InputError("--topics and --world are for bags, but no bag is named")
    world = None
    if arguments.world:
        worlds = find_worlds(checked(Worlds, parse_yaml(arguments.world, "--world"), "--world"))
        if len(worlds) > 1:
            raise InputError(f"--world takes one world, got {len(worlds)}")
        world = worlds[0]
    return [drive_section(read_drive(bag, topics), world) for bag in progress_bar(bags, "reading", "bag")]


def _page_file(arguments: argparse.Namespace) -> Path:
    """The file of the page.

    Raises:
        InputError: If it cannot be written, before any work is done.
    """
    single = Path(arguments.runs[0]) if len(arguments.runs) == 1 else Path()
    out = arguments.out or (single if single.is_dir() else Path()) / "report.html"
    if out.is_dir() or not out.absolute().parent.is_dir() or not os.access(out.absolute().parent, os.W_OK):
        raise InputError(f"cannot write {out}: name a file in a writable folder")
    return out
