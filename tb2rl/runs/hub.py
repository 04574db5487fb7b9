"""Policies on the Hugging Face hub, "hf:user/repository" or "hf:user/repository@revision".

A repository contains the files of a shared run folder, see `tb2rl.runs.folder`. huggingface_hub downloads only these
files, which contain no code, into its own cache. The cache also works offline.
"""

import re
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from logging import CRITICAL
from pathlib import Path
from typing import Any

from tb2rl.core.errors import InputError, install_extra, one_line
from tb2rl.runs.folder import EVALUATION, EVALUATIONS, SHARED_CONFIG, is_shared

HUB = "hf:"  # prefix of references
POLICY = "best/policy.safetensors"  # path of the checkpoint in a repository
_DOWNLOADED_FILES = [SHARED_CONFIG, POLICY, EVALUATION, EVALUATIONS]
_REFERENCE = re.compile(r"hf:([\w.-]+/[\w.-]+)(?:@([\w./-]+))?")


def download(reference: str) -> Path:
    """Download the files of a reference, unless they are cached; return the local folder."""
    repository, revision = parse_reference(reference)
    hub = hub_library()
    with translate_errors(reference):
        # A single worker is used, because workers share a connection, and a worker that fails closes this connection.
        options = {"max_workers": 1, "allow_patterns": _DOWNLOADED_FILES}
        folder = Path(hub.snapshot_download(repository, revision=revision, **options))
    if not is_shared(folder) or not (folder / POLICY).is_file():
        raise InputError(f"{reference} is not a policy of tb2rl: it lacks {SHARED_CONFIG} or {POLICY}")
    return folder


def parse_reference(reference: str) -> tuple[str, str | None]:
    """Split a reference into repository and revision; None as revision means the newest."""
    match = _REFERENCE.fullmatch(reference)
    if match is None:
        raise InputError(f"a policy on the hub is hf:user/repository, got {one_line(reference, 100)}")
    return match[1], match[2]


def cached_reference(folder: Path) -> str | None:
    """The reference of a folder in the cache of huggingface_hub; None for any other folder."""
    match = re.fullmatch(r"models--(.+)--(.+)", folder.parent.parent.name)
    return f"{HUB}{match[1]}/{match[2]}" if match and folder.parent.name == "snapshots" else None


def hub_library() -> Any:
    """Import the module huggingface_hub."""
    try:
        import huggingface_hub.utils  # also imports the submodules `constants` and `errors`
    except ImportError:
        raise InputError(f"the hub needs the extra `hub`: {install_extra('hub')}") from None
    return huggingface_hub


@contextmanager
def translate_errors(reference: str) -> Iterator[None]:
    """Translate errors of huggingface_hub, except file errors, into one line.

    The line does not contain the request, because requests contain the user's token.
    """
    hub = hub_library()
    names = ("HfHubHTTPError", "HFValidationError", "LocalEntryNotFoundError", "LocalTokenNotFoundError")
    try:
        with _suppress_output(hub.utils):
            yield
    except tuple(getattr(hub.errors, name) for name in names) as error:
        raise InputError(one_line(f"{reference}: {error}")) from None
    except Exception as error:
        if isinstance(error, InputError) or (isinstance(error, OSError) and error.filename):  # a file of the cache
            raise
        problem = f"the hub at {hub.constants.ENDPOINT} cannot be reached ({type(error).__name__})"
        raise InputError(f"{reference}: {problem}") from None


@contextmanager
def _suppress_output(utils: Any) -> Iterator[None]:
    """Suppress the library's log messages, and its progress bars unless stderr is a terminal."""
    with ExitStack() as restore:
        restore.callback(utils.logging.set_verbosity, utils.logging.get_verbosity())
        utils.logging.set_verbosity(CRITICAL)
        if not sys.stderr.isatty() and not utils.are_progress_bars_disabled():
            restore.callback(utils.enable_progress_bars)
            utils.disable_progress_bars()
        yield
