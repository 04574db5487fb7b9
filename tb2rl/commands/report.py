"""What `report` does, see `tb2rl.report`: reads runs and results of suites, writes the page."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from tb2rl.errors import InputError
from tb2rl.files import write_text
from tb2rl.judging.progress import progress as progress_bar
from tb2rl.judging.suite_result import kept_result
from tb2rl.showing.groups import grouped
from tb2rl.showing.page import page
from tb2rl.showing.subjects import names_of, read_subject, run_folders
from tb2rl.showing.suites import result_files, suite_section


def run(options: argparse.Namespace) -> None:
    """Read the runs and the results of suites, write the page, say where it is."""
    files = [reference for reference in options.runs if Path(reference).is_file()]
    folders = run_folders([reference for reference in options.runs if reference not in files])
    out = _page_file(options)
    results = [(file, kept_result(file)) for file in result_files(map(Path, files), folders)]
    named = list(zip(folders, names_of(folders), strict=True))
    subjects = [read_subject(folder, name, progress=True) for folder, name in progress_bar(named, "reading", "run")]
    groups = grouped(subjects)
    text = page(groups, [suite_section(file, result, progress=True) for file, result in results], progress=True)
    try:
        write_text(out, text)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror}") from None
    print(f"{out}: {_counted(run=len(folders), suite=len(results))}, {len(text.encode()) / 1e6:.1f} MB")


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
