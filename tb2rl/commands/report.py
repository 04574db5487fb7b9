"""What `report` does, see `tb2rl.report`: reads runs, results of suites and bags, writes the page."""

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
from tb2rl.viz.comparing import compare, comparison_page, read_side
from tb2rl.viz.drives import DriveSection, drive_section
from tb2rl.viz.groups import grouped
from tb2rl.viz.page import page
from tb2rl.viz.subjects import names_of, read_subject, run_folders
from tb2rl.viz.suites import result_files, suite_section


def run(options: argparse.Namespace) -> None:
    """Read the runs, the results of suites and the bags, write the page, say where it is."""
    if options.compare:
        _compare(options)
        return
    bags = [reference for reference in options.runs if is_bag(Path(reference))]
    files = [reference for reference in options.runs if reference not in bags and Path(reference).is_file()]
    folders = run_folders([reference for reference in options.runs if reference not in [*bags, *files]])
    out = _page_file(options)
    drives = _drives(options, [Path(bag) for bag in dict.fromkeys(bags)])
    results = [(file, kept_result(file)) for file in result_files(map(Path, files), folders)]
    named = list(zip(folders, names_of(folders), strict=True))
    bar = progress_bar(named, "reading", "run")
    subjects = [read_subject(folder, name, progress=True, trust=options.trust) for folder, name in bar]
    groups = grouped(subjects)
    suites = [suite_section(file, result, progress=True) for file, result in results]
    text = page(groups, suites, drives, progress=True)
    _write(out, text)
    print(
        f"{out}: {_counted(run=len(folders), suite=len(results), drive=len(drives))}, {len(text.encode()) / 1e6:.1f} MB"
    )


def _compare(options: argparse.Namespace) -> None:
    """Hold two folders of runs against each other, say which is better, write the page."""
    if len(options.runs) != 2 or options.topics or options.world:
        raise InputError("--compare takes two folders of runs, and nothing of bags")
    ones, others = ({folder.resolve() for folder in run_folders([reference])} for reference in options.runs)
    if ones & others:
        raise InputError(f"--compare takes different runs, and {min(ones & others)} is on both sides")
    out = _page_file(options)
    one, other = (read_side(reference, options.trust) for reference in options.runs)
    measures = compare(one, other)
    for measure in measures:
        print(f"{measure.title}: {_said(measure.middles[0])} and {_said(measure.middles[1])}. {measure.verdict}")
    _write(out, comparison_page(one, other, measures))
    print(out)


def _said(estimate: Estimate) -> str:
    return f"{100 * estimate.value:.1f} % ({100 * estimate.low:.1f} to {100 * estimate.high:.1f} %)"


def _write(out: Path, text: str) -> None:
    try:
        write_text(out, text)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror}") from None


def _drives(options: argparse.Namespace, bags: list[Path]) -> list[DriveSection]:
    """What the page says of bags."""
    topics = parse_topics(options.topics)
    if (topics or options.world) and not bags:
        raise InputError("--topics and --world are for bags, and none is named")
    worlds = find_worlds(checked(Worlds, parse_yaml(options.world, "--world"), "--world")) if options.world else ()
    if len(worlds) > 1:
        raise InputError(f"--world takes one world, got {len(worlds)}")
    world = worlds[0] if worlds else None
    return [drive_section(read_drive(bag, topics), world) for bag in progress_bar(bags, "reading", "bag")]


def _counted(**things: int) -> str:
    """How many of each there are, where there are any: "2 runs, 1 suite"."""
    return ", ".join(f"{count} {name}{'s' * (count > 1)}" for name, count in things.items() if count)


def _page_file(options: argparse.Namespace) -> Path:
    """Where the page goes; an `InputError` if it cannot, before any work is done."""
    alone = Path(options.runs[0]) if len(options.runs) == 1 else Path()
    out = options.out or (alone if alone.is_dir() else Path()) / "report.html"
    if out.is_dir() or not out.absolute().parent.is_dir() or not os.access(out.absolute().parent, os.W_OK):
        raise InputError(f"cannot write {out}: name a file in a folder that exists and takes files")
    return out
