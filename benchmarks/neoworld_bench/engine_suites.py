"""Options of the suites that measure engines and kernels."""

from dataclasses import dataclass
from pathlib import Path

from neoworld_mjx.engines import ENGINES, EngineName


@dataclass(frozen=True, kw_only=True)
class Physics:
    """Time rollouts of noisy layouts, compared with the naive loop and a bare MJX scan."""

    objects: tuple[int, ...] = (3, 6, 10, 20, 40)
    """Numbers of objects on the table."""
    population: tuple[int, ...] = (1024,)
    """Numbers of candidates."""
    engine: tuple[EngineName, ...] = tuple(ENGINES)
    """Engines; the row of an engine that cannot run here gives the reason."""
    duration: float = 1.0
    """Simulated time [s], in steps of 4 ms."""
    budget: float = 60.0
    """Time limit of a row [s]; a row that needs longer is skipped."""
    seed: int = 0
    """Seed of scenes and layouts."""
    chart: Path | None = None
    """SVG file for a chart of the growth of cost."""


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
    """Time limit of the calls of a row [s]."""
    seed: int = 0
    """Seed of scenes and layouts."""
    pairs: int = 10_000
    """Random pairs of convex shapes whose sampled depth is compared with the exact one; 0 for
    none.
    """
    table: Path | None = None
    """JSON file of measured devices to add this device to; `pair_depth` reads it."""


@dataclass(frozen=True, kw_only=True)
class Devices:
    """Time rollouts by mjx and a sweep on one device, two, and so on up to all of this host."""

    devices: tuple[int, ...] = ()
    """Numbers of devices; by default 1, 2, 4 and so on up to all. On a CPU they are simulated."""
    objects: tuple[int, ...] = (6, 20)
    """Numbers of objects on the table of the rollouts; none with --no-rollouts."""
    population: int = 8192
    """Candidates of the rollouts."""
    points: int = 64
    """Points of the sweep on the scene of the bundled photograph, by Algorithm 1."""
    seeds: int = 8
    """Seeds of each point."""
    sweep_population: int = 64
    """Candidates of an iteration of each run of the sweep."""
    iterations: int = 2
    """Iterations of each run."""
    no_rollouts: bool = False
    """Leave out the rollouts."""
    no_sweep: bool = False
    """Leave out the sweep."""
    repeats: int = 3
    """Repetitions of a rollout, of which the median counts; the sweep runs once, and its time is
    without compilation."""
    budget: float = 600.0
    """Time limit of each row's process [s]."""
    seed: int = 0
    """Seed of scenes and layouts."""


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Compare engines with MuJoCo on recompiled scenes: fields, bits, first steps, verdicts."""

    scene: tuple[str, ...] = ()
    """Scenes: stack, cluttered, cabinet, container, leaning, mixed; all six by default."""
    engine: tuple[EngineName, ...] = ("native",)
    """Engines whose verdicts are compared."""
    layouts: int = 64
    """Candidates of each scene."""
    seed: int = 0
    """Seed of the layouts."""
