"""Policies on the hub of Hugging Face, "hf:user/repository" or "hf:user/repository@revision".

A repository holds a run folder's files as safetensors and JSON, see `tb2rl.runs.folder`. The library huggingface_hub
downloads them into its own cache, which is asked where there is no connection.
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
_NEEDED = (SHARED, POLICY)
_READ = (*_NEEDED, EVALUATION, EVALUATIONS)
_ENDINGS = (".safetensors", ".json", ".jsonl", ".md", ".txt", ".png", ".jpg", ".gif", ".svg", ".mp4")
_OTHERS = (".gitattributes", ".gitignore", "LICENSE")
_LARGEST = {".safetensors": 2**29, ".json": 2**23, ".jsonl": 2**23}  # [bytes] 100 million weights fit
_REFERENCE = re.compile(r"hf:([\w.-]+/[\w.-]+)(?:@([\w./-]+))?")
_LOG_IN = "log in with `hf auth login`, or set HF_TOKEN"


def downloaded(reference: str) -> Path:
    """The folder with what a reference means, downloaded if it is not in the library's cache yet.

    Raises:
        InputError: If there is no such repository, or it cannot be had, or holds what no policy needs, such as code.
    """
    repository, revision = parsed(reference)
    hub = library()
    # One worker: several close the connection that they share when one of them fails.
    wanted: dict[str, Any] = {"revision": revision, "allow_patterns": list(_READ), "max_workers": 1}
    with errors_named(reference, repository):
        api = hub.HfApi()
        try:
            info = api.model_info(repository, revision=revision, files_metadata=True)
        except hub.errors.HfHubHTTPError:
            raise
        except Exception:  # of whatever carries its requests: there is no connection
            return Path(api.snapshot_download(repository, **wanted, local_files_only=True))
        _check(reference, info.siblings or [])
        folder = Path(api.snapshot_download(repository, **wanted))
    if folder.name != info.sha:
        raise InputError(f"{reference} is changing right now; try again")
    return folder


def parsed(reference: str) -> tuple[str, str | None]:
    """The repository and the revision of a reference; None: its newest.

    Raises:
        InputError: If it is not one.
    """
    found = _REFERENCE.fullmatch(reference)
    if found is None:
        raise InputError(f"a policy on the hub is hf:user/repository, got {one_line(reference, 100)}")
    return found[1], found[2]


def name_of(folder: Path) -> str | None:
    """The reference that a folder in the library's cache stands for; None: it is another folder."""
    cached = re.fullmatch(r"models--(.+)--(.+)", folder.parent.parent.name)
    return f"{HUB}{cached[1]}/{cached[2]}" if cached and folder.parent.name == "snapshots" else None


def library() -> Any:
    """The library huggingface_hub.

    Raises:
        InputError: If it is not installed.
    """
    try:
        import huggingface_hub
        import huggingface_hub.constants
        import huggingface_hub.errors
        import huggingface_hub.utils
    except ImportError:
        raise InputError(f"the hub takes the extra `hub`: {install_extra('hub')}") from None
    return huggingface_hub


@contextmanager
def errors_named(what: str, repository: str) -> Iterator[None]:
    """Turn what the library raises into one line, which says nothing of what was sent: that holds the token.

    Raises:
        InputError: For whatever goes wrong, but for files that cannot be written.
    """
    hub = library()
    errors = hub.errors
    try:
        with _quiet(hub.utils):
            yield
    except InputError:
        raise
    except errors.GatedRepoError:
        raise InputError(f"{what}: its owner must let you in; ask on its page, and {_LOG_IN}") from None
    except errors.RevisionNotFoundError:
        raise InputError(f"{what}: the repository has no such revision") from None
    except errors.RepositoryNotFoundError:
        raise InputError(f"{what}: there is no repository {repository}, or it is private: {_LOG_IN}") from None
    except errors.HFValidationError:
        raise InputError(f"{what}: {repository} cannot be the name of a repository") from None
    except errors.HfHubHTTPError as error:
        status = error.response.status_code
        hint = f"; {_LOG_IN}, with a token that may do this" if status in (401, 403) else ""
        raise InputError(f"{what}: the hub answers with status {status}{hint}") from None
    except errors.LocalTokenNotFoundError:
        raise InputError(f"{what}: the hub must know who you are; {_LOG_IN}") from None
    except errors.LocalEntryNotFoundError:
        raise InputError(f"{what}: there is no connection to the hub, and it was not downloaded before") from None
    except Exception as error:
        if isinstance(error, OSError) and error.filename:  # of the cache
            raise
        why = type(error).__name__
        raise InputError(f"{what}: the hub at {hub.constants.ENDPOINT} cannot be reached ({why})") from None


@contextmanager
def _quiet(utils: Any) -> Iterator[None]:
    """Leave it to our own line to say what goes wrong, and draw the library's bars on a terminal only."""
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


def _check(reference: str, files: Iterable[Any]) -> None:
    """Raise an `InputError` for a repository that holds more than data, or lacks something, or is too large."""
    sizes = {file.rfilename: file.size or 0 for file in files}
    for path, size in sizes.items():
        shown, ending = one_line(repr(path), 100), PurePosixPath(path).suffix.lower()
        if not path.isprintable() or set(path) & set("\\:") or {"", ".", ".."} & set(path.split("/")):
            raise InputError(f"{reference} is refused: {shown} in it is not a path within a repository")
        if ending not in _ENDINGS and path not in _OTHERS:
            raise InputError(f"{reference} is refused: it holds {shown}, and a policy is safetensors and JSON alone")
        if path in _READ and size > _LARGEST[ending]:
            raise InputError(f"{reference} is refused: {shown} in it is too large, {size / 1e6:.0f} MB")
    for path in _NEEDED:
        if path not in sizes:
            raise InputError(f"{reference} is not a policy of tb2rl: it has no {path}")
