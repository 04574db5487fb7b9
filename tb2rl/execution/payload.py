"""Serialized objects that all jobs of a call share, and the cache of them in a worker."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cloudpickle

_cache: dict[str, Any] = {}  # objects of the current call in this worker, by digest


@dataclass(frozen=True)
class Payload:
    """A serialized object; equal content has the same digest."""

    digest: str
    content: bytes


def serialize(value: Any) -> Payload:
    """Serialize an object by value, including classes and functions of the main script."""
    content = cloudpickle.dumps(value)
    return Payload(hashlib.sha256(content).hexdigest(), content)


def deserialize(digests: Sequence[str], fetch: Callable[[str], bytes]) -> list[Any]:
    """The objects of these digests; each is loaded once, and dropped when a call does not share it any more.

    Args:
        digests: Of the payloads.
        fetch: Returns the content of a payload by its digest.
    """
    for digest in set(_cache) - set(digests):
        del _cache[digest]
    for digest in digests:
        if digest not in _cache:
            _cache[digest] = pickle.loads(fetch(digest))
    return [_cache[digest] for digest in digests]
