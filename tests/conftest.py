"""Fixtures and rules for every test: no keys, compilations kept between runs, shared example
runs.
"""

import fcntl
import gc
import hashlib
import importlib.metadata
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

# Before NumPy is imported. The cores are shared by the workers, and threads of BLAS that wait for
# small products took a fifth of the time of the tests of the fit.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tests.support.type_checks import check_anew, check_annotations, keep_code

check_annotations()

PHOTO = Path(__file__).parents[1] / "examples" / "coffee.png"
FAST_COMPILATION = (
    "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
    " --xla_cpu_parallel_codegen_split_count=1"
)
"""Tests compile more than they run: a search's gradient refinement took 6.6 s without the last
flag and the next ones, 2.7 s with them."""
FLAGS_BEFORE = {(0, 11, 1): " --xla_cpu_use_fusion_emitters=false"}
"""Flags that jaxlib no longer knows from a version on; XLA ends the process at an unknown one."""
LONG = (
    *("commands", "test_pipeline", "pipeline", "search", "bench", "estimate", "kernels"),
    *("physics", "environments", "sweeps", "test_recipes", "notebooks", "verify", "program"),
    *("outside", "test_faults", "test_examples"),
)
"""Folders and files that take longest; several workers begin with them and end together."""
QUICK = {
    "compose": {"looks": False},
    "refine": {"cem": {"population": 24, "iterations": 2}},
    "render": {"width": 96, "supersample": 1},
}
"""Options with which the example takes seconds."""


class Ended(NamedTuple):
    """Exit code and output of a command line."""

    returncode: int
    stdout: str
    stderr: str


def pytest_configure(config: pytest.Config) -> None:
    # Before JAX is imported, and for the processes that tests start; what was compiled once is
    # taken from the disk the next time, which is most of the time of the whole suite.
    cache = getattr(config, "cache", None)
    if cache is not None:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache.mkdir("jax")))
        keep_code(cache.mkdir("checked"))
        if sys.dont_write_bytecode:
            # Without bytecode beside the sources, each process would compile every library anew.
            os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix = str(cache.mkdir("bytecode"))
            os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
            sys.dont_write_bytecode = False
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    installed = tuple(map(int, importlib.metadata.version("jaxlib").split(".")[:3]))
    known = "".join(flag for end, flag in FLAGS_BEFORE.items() if installed < end)
    os.environ.setdefault("XLA_FLAGS", FAST_COMPILATION + known)
    # Tracing makes many objects that live on, and the default looks at all of them often.
    gc.set_threshold(50_000, 10, 10)
    # xdist would begin with the files of the most tests.
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=_rank)
    slow = pytest.mark.skip(reason="slow; run with -m slow")
    gpu = pytest.mark.skip(reason="needs an NVIDIA GPU")
    for item in items:
        if item.get_closest_marker("slow") and "slow" not in config.getoption("-m"):
            item.add_marker(slow)
        if item.get_closest_marker("gpu") and shutil.which("nvidia-smi") is None:
            item.add_marker(gpu)


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()


def pytest_runtest_setup() -> None:
    check_anew()


@pytest.fixture(autouse=True)
def _no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep every test from reaching a server with the key of whoever runs it."""
    for name in ("ANTHROPIC_API_KEY", "OPENAI_API_KEY"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def neoworld(capfd):
    """Run the command line in this process."""
    from neoworld_mjx import cli

    def run(*words) -> Ended:
        with pytest.raises(SystemExit) as ended:
            cli.main([str(word) for word in words])
        return Ended(ended.value.code, *capfd.readouterr())

    return run


@pytest.fixture(scope="session")
def photo() -> Path:
    """The photograph of the bundled example."""
    return PHOTO


@pytest.fixture(scope="session")
def quick_config():
    """Options with which the example takes seconds."""
    from neoworld_mjx.config import load_config

    return load_config(None, QUICK)


@pytest.fixture(scope="session")
def example_run(tmp_path_factory):
    """The first command of the README, whole, once for all workers: its run folder, which tests
    only read, and its answer.
    """
    home = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        home = home.parent
    out, answer = home / "example" / "out", home / "example.json"
    command = [sys.executable, "-m", "neoworld_mjx.cli", "reconstruct", str(PHOTO)]
    with (home / "example.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not answer.exists():
            done = subprocess.run(
                [*command, "--out", str(out), "--json"], capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr
            answer.write_text(done.stdout)
    before = _digest(out)
    yield out, json.loads(answer.read_text())
    assert _digest(out) == before, "a test changed the shared run; copy it first"


@pytest.fixture(scope="session")
def blocks_model():
    """The compiled scene of `scenes.blocks`; what is jitted with it is compiled once for all
    tests.
    """
    from tests.support import scenes
    from tests.support.scenes import compile_scene

    return compile_scene(scenes.blocks())


def _rank(item: pytest.Item) -> int:
    at = item.path.relative_to(Path(__file__).parent).parts[0].removesuffix(".py")
    return LONG.index(at) if at in LONG else len(LONG)


def _digest(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".lock"
    }
