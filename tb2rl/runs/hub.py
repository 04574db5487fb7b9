"""Policies on the Hugging Face hub, "hf:user/repository" or "hf:user/repository@revision".

A repository holds the files of a run folder as safetensors and JSON, see `tb2rl.runs.folder`. huggingface_hub downloads
them into its own cache, which is also used without a connection.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from logging import CRITICAL
from pathlib import Path, PurePosixPath
from typing import Any

from tb2rl.core.errors import InputError, install_extra, one_line
from tb2rl.runs.folder import EVALUATION, EVALUATIONS, SHARED

HUB = "hf:"
POLICY = "best/policy.safetensors"
_REQUIRED = (SHARED, POLICY)
_READ = (*_REQUIRED, EVALUATION, EVALUATIONS)
_ENDINGS = (".safetensors", ".json", ".jsonl", ".md", ".txt", ".png", ".jpg", ".gif", ".svg", ".mp4")
_OTHERS = (".gitattributes", ".gitignore", "LICENSE")
_LARGEST = {".safetensors": 2**29, ".json": 2**23, ".jsonl": 2**23}  # [bytes] enough for 100 million weights
_REFERENCE = re.compile(r"hf:([\w.-]+/[\w.-]+)(?:@([\w./-]+))?")
_LOG_IN = "log in with `hf auth login`, or set HF_TOKEN"


def download(reference: str) -> Path:
    """The local folder of a reference, downloaded unless it is in the library's cache.

    Raises:
        InputError: If the repository does not exist, cannot be downloaded, or holds anything but data.
    """
    repository, revision = parse_reference(reference)
    hub = hub_library()
    # One worker, because several close their shared connection when one of them fails.
    options: dict[str, Any] = {"revision": revision, "allow_patterns": list(_READ), "max_workers": 1}
    with translate_errors(reference, repository):
        api = hub.HfApi()
        try:
            info = api.model_info(repository, revision=revision, files_metadata=True)
        except hub.errors.HfHubHTTPError:
            raise
        except Exception:  # of any HTTP library: there is no connection
            return Path(api.snapshot_download(repository, **options, local_files_only=True))
        _check_files(reference, info.siblings or [])
        folder = Path(api.snapshot_download(repository, **options))
    if folder.name != info.sha:
        raise InputError(f"{reference} is changing right now; try again")
    return folder


def parse_reference(reference: str) -> tuple[str, str | None]:
    """Repository and revision of a reference; revision None: the newest."""
    found = _REFERENCE.fullmatch(reference)
    if found is None:
        raise InputError(f"a policy on the hub is hf:user/repository, got {one_line(reference, 100)}")
    return found[1], found[2]


def cached_reference(folder: Path) -> str | None:
    """The reference of a folder in the library's cache; None for any other folder."""
    cached = re.fullmatch(r"models--(.+)--(.+)", folder.parent.parent.name)
    return f"{HUB}{cached[1]}/{cached[2]}" if cached and folder.parent.name == "snapshots" else None


def hub_library() -> Any:
    """The module huggingface_hub."""
    try:
        import huggingface_hub
        import huggingface_hub.constants
        import huggingface_hub.errors
        import huggingface_hub.utils
    except ImportError:
        raise InputError(f"the hub takes the extra `hub`: {install_extra('hub')}") from None
    return huggingface_hub


@contextmanager
def translate_errors(what: str, repository: str) -> Iterator[None]:
    """Turn errors of the library into one line without the request, because that contains the token.

    Raises:
        InputError: For any error except files that cannot be written.
    """
    hub = hub_library()
    errors = hub.errors
    messages = {  # a class before its base class
        errors.GatedRepoError: f"its owner must let you in; ask on its page, and {_LOG_IN}",
        errors.RevisionNotFoundError: "the repository has no such revision",
        errors.RepositoryNotFoundError: f"there is no repository {repository}, or it is private: {_LOG_IN}",
        errors.HFValidationError: f"{repository} cannot be the name of a repository",
        errors.LocalTokenNotFoundError: f"the hub must know who you are; {_LOG_IN}",
        errors.LocalEntryNotFoundError: "there is no connection to the hub, and it was not downloaded before",
    }
    try:
        with _quiet(hub.utils):
            yield
    except InputError:
        raise
    except Exception as error:
        message = next((text for kind, text in messages.items() if isinstance(error, kind)), None)
        if message is None and isinstance(error, errors.HfHubHTTPError):
            status = error.response.status_code
            hint = f"; {_LOG_IN}, with a token that may do this" if status in (401, 403) else ""
            message = f"the hub answers with status {status}{hint}"
        elif message is None and isinstance(error, OSError) and error.filename:  # of the cache
            raise
        if message is None:
            message = f"the hub at {hub.constants.ENDPOINT} cannot be reached ({type(error).__name__})"
        raise InputError(f"{what}: {message}") from None


@contextmanager
def _quiet(utils: Any) -> Iterator[None]:
    """Suppress the library's log messages, and its progress bars unless stderr is a terminal."""
    verbosity, bars = utils.logging.get_verbosity(), not utils.are_progress_bars_disabled()
    utils.logging.set_verbosity(CRITICAL)
    if not sys.stderr.isatty():
        utils.disable_progress_bars()
    try:
        yield
    finally:
        utils.logging.set_verbosity(verbosity)
        if bars:
            utils.enable_progress_bars()


def _check_files(reference: str, files: Iterable[Any]) -> None:
    """Raise an `InputError` if a repository holds anything but data, lacks a file, or has one that is too large."""
    sizes = {file.rfilename: file.size or 0 for file in files}
    for path, size in sizes.items():
        shown, ending = one_line(repr(path), 100), PurePosixPath(path).suffix.lower()
        if ending not in _ENDINGS and path not in _OTHERS:
            raise InputError(f"{reference} is refused: it holds {shown}, and a policy is safetensors and JSON alone")
        if path in _READ and size > _LARGEST[ending]:
            raise InputError(f"{reference} is refused: {shown} in it is too large, {size / 1e6:.0f} MB")
    for path in _REQUIRED:
        if path not in sizes:
            raise InputError(f"{reference} is not a policy of tb2rl: it has no {path}")
