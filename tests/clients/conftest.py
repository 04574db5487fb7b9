"""Programs of users that use tb2rl together with other libraries, a file for each library."""

import pytest
import torch as th


@pytest.fixture(autouse=True)
def one_thread_of_torch():
    """The networks are small: torch's threads would only wait for each other, and for other tests."""
    number = th.get_num_threads()
    th.set_num_threads(1)
    yield
    th.set_num_threads(number)
