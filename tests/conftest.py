import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    """Small matrices on two threads take ten times as long where a core is busy."""
    with threadpool_limits(1, user_api="blas"):
        yield
