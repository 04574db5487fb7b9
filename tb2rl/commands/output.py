"""Output files of commands: `--json FILE`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tb2rl.core.errors import InputError
from tb2rl.core.files import write_text


def check_output(file: Path | None) -> None:
    """Raise an `InputError` if the folder of an output file does not exist; call it before long work."""
    if file is not None and not file.absolute().parent.is_dir():
        raise InputError(f"cannot write {file}: there is no folder {file.absolute().parent}")


def write_json(file: Path, tree: Any) -> None:
    """Write plain values as JSON.

    Raises:
        InputError: If the file cannot be written.
    """
    try:
        write_text(file, json.dumps(tree, indent=1) + "\n")
    except OSError as error:
        raise InputError(f"cannot write {file}: {error.strerror}") from None
