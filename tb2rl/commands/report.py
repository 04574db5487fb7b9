"""What `report` does, see `tb2rl.report`: reads the runs, writes the page."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from tb2rl.errors import InputError
from tb2rl.files import write_text
from tb2rl.judging.progress import progress as progress_bar
from tb2rl.showing.groups import grouped
from tb2rl.showing.page import page
from tb2rl.showing.subjects import names_of, read_subject, run_folders


def run(options: argparse.Namespace) -> None:
    """Read the runs, write the page, say where it is."""
    folders = run_folders(options.runs)
    out = _page_file(options)
    named = list(zip(folders, names_of(folders), strict=True))
    subjects = [read_subject(folder, name, progress=True) for folder, name in progress_bar(named, "reading", "run")]
    text = page(grouped(subjects), progress=True)
    try:
        write_text(out, text)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror}") from None
    count = "1 run" if len(folders) == 1 else f"{len(folders)} runs"
    print(f"{out}: {count}, {len(text.encode()) / 1e6:.1f} MB")


def _page_file(options: argparse.Namespace) -> Path:
    """Where the page goes; an `InputError` if it cannot, before any work is done."""
    alone = Path(options.runs[0]) if len(options.runs) == 1 else Path()
    out = options.out or (alone if alone.is_dir() else Path()) / "report.html"
    if out.is_dir() or not out.absolute().parent.is_dir() or not os.access(out.absolute().parent, os.W_OK):
        raise InputError(f"cannot write {out}: name a file in a folder that exists and takes files")
    return out
