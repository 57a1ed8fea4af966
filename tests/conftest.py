"""What every test gets: no keys, compilations kept between runs, markers that mean something."""

import os
import shutil

import pytest


def pytest_configure(config: pytest.Config) -> None:
    # Before JAX is imported, and for the processes that tests start; what was compiled once is
    # taken from the disk the next time, which is most of the time of the whole suite.
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ and config.cache is not None:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(config.cache.mkdir("jax"))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    slow = pytest.mark.skip(reason="slow; run with -m slow")
    gpu = pytest.mark.skip(reason="needs an NVIDIA GPU")
    for item in items:
        if "slow" in item.keywords and "slow" not in config.getoption("-m"):
            item.add_marker(slow)
        if "gpu" in item.keywords and shutil.which("nvidia-smi") is None:
            item.add_marker(gpu)


@pytest.fixture(autouse=True)
def _no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """No test may reach a server with the key of whoever runs it."""
    for name in ("ANTHROPIC_API_KEY", "OPENAI_API_KEY"):
        monkeypatch.delenv(name, raising=False)
