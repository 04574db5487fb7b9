"""User programs with other libraries, a file for each library."""

import pytest
import torch as th


@pytest.fixture(autouse=True)
def one_thread_of_torch():
    """Use one thread of torch, because the networks are small and other tests use the processors."""
    number = th.get_num_threads()
    th.set_num_threads(1)
    yield
    th.set_num_threads(number)
