"""The desk with five objects and its photograph, which the tests of this folder only read."""

import pytest


# The desk is imported here: JAX's options are set after this file is read.
@pytest.fixture(scope="session")
def five():
    from tests.estimate import desk

    return desk.five()


@pytest.fixture(scope="session")
def photo(five):
    """In 640 columns."""
    from tests.estimate import desk

    return desk.photograph(five, 640)
