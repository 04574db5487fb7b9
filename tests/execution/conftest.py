"""Ray for the tests that need it."""

import pytest


@pytest.fixture(scope="module")
def ray():
    """Ray, which ends with the tests of a module."""
    module = pytest.importorskip("ray", reason="Ray is not installed (extra: ray)")
    yield module
    module.shutdown()
