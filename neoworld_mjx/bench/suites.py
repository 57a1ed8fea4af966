"""The table of benchmark suites: the options of each, and the function that runs it.

A suite is a module with a function from options to a JSON object, and a row of `SUITES`. Nothing
heavy is imported here, so that `--help` is quick; the function is imported when it is called.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, NamedTuple

from ..engines import ENGINES, EngineChoice, EngineName


class Suite(NamedTuple):
    """A row of a table of suites."""

    options: type
    """Dataclass of its options; its docstring is the help of the command."""
    function: str
    """`package.module:function`, called with the options, and with the configuration if it takes
    one.
    """
    configured: bool = False
    """Whether it takes `--config` and `--set`."""

    def load(self) -> Callable[..., dict[str, Any]]:
        """Import the function."""
        module, name = self.function.split(":")
        return getattr(import_module(module), name)


@dataclass(frozen=True, kw_only=True)
class Physics:
    """Time rollouts of noisy layouts, beside the naive loop and a bare scan of MJX."""

    objects: tuple[int, ...] = (3, 6, 10, 20, 40)
    """Numbers of objects on the table."""
    population: tuple[int, ...] = (1024,)
    """Numbers of candidates."""
    engine: tuple[EngineName, ...] = tuple(ENGINES)
    """Engines; one that cannot run here is a row that says why."""
    duration: float = 1.0
    """Simulated time [s], in steps of 4 ms."""
    budget: float = 60.0
    """Time that a row may take [s]; one that needs longer is skipped."""
    seed: int = 0
    """Seed of scenes and layouts."""
    chart: Path | None = None
    """SVG file to draw the growth of cost into."""


@dataclass(frozen=True, kw_only=True)
class Kernels:
    """Time the implementations of the penetration term."""

    objects: tuple[int, ...] = (3, 10, 40)
    """Numbers of objects on the table."""
    population: tuple[int, ...] = (256, 4096)
    """Numbers of candidates."""
    samples: int = 256
    """Surface samples of each object."""
    budget: float = 60.0
    """Time that the calls of a row may take [s]."""
    seed: int = 0
    """Seed of scenes and layouts."""
    pairs: int = 10_000
    """Random pairs of convex shapes whose sampled depth is compared with the exact one; 0 for
    none.
    """
    table: Path | None = None
    """JSON file of measured devices to enter this one into: what `pair_depth` chooses by."""


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Compare engines with MuJoCo on recompiled scenes: fields, bits, first steps, verdicts."""

    scene: tuple[str, ...] = ()
    """Of stack, cluttered, cabinet, container, leaning and mixed; none takes all six."""
    engine: tuple[EngineName, ...] = ("native",)
    """Engines whose verdicts are compared."""
    layouts: int = 64
    """Candidates of each scene."""
    seed: int = 0
    """Seed of the layouts."""


@dataclass(frozen=True, kw_only=True)
class Refine:
    """Refine scenes with known truth from noisy starts, beside Algorithm 1, random search and
    CMA-ES.
    """

    scene: tuple[str, ...] = ()
    """Names of scenes; none takes all twelve. crowd_20 and crowd_40 are there too."""
    seeds: int = 5
    """Starts of each scene."""
    baseline_seeds: int = 1
    """How many of the starts the baselines take; Algorithm 1 takes half a minute each."""
    baseline: tuple[Literal["algorithm1", "random", "cma_es"], ...] = (
        "algorithm1",
        "random",
        "cma_es",
    )
    """Baselines to run; none with `--baseline` and nothing after it."""
    engine: EngineChoice = "native"
    """Engine that rolls candidates out."""


SUITES = {
    "physics": Suite(Physics, "neoworld_mjx.bench.command:physics_answer"),
    "kernels": Suite(Kernels, "neoworld_mjx.bench.command:kernels_answer"),
    "agreement": Suite(Agreement, "neoworld_mjx.bench.command:agreement_answer"),
    "refine": Suite(Refine, "neoworld_mjx.bench.command:refine_answer", configured=True),
}
"""What `neoworld bench run NAME` runs."""

DEVELOPER_SUITES = ("battery", "programs", "scoring", "verify")
"""What `python -m benchmarks NAME` runs from a clone."""
