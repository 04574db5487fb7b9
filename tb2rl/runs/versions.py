"""Versions of the packages that a result depends on, kept in runs and evaluations."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

import torch as th

_PACKAGES = ("tb2rl", "stable-baselines3", "torch", "gymnasium", "pybullet", "numpy", "numba", "safetensors")


def versions() -> dict[str, str]:
    """Versions of Python and of packages; torch's includes its build, which package metadata may omit."""
    packages = {package: _version(package) for package in _PACKAGES}
    return {"python": platform.python_version(), **packages, "torch": str(th.__version__)}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # tb2rl in a checkout, PyBullet where it has no wheel
        return "not installed"
