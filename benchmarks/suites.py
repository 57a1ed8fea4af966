"""The table of developer suites: the options of each, and the function that runs it."""

from dataclasses import dataclass
from typing import Literal

from neoworld_mjx.bench.suites import Suite


@dataclass(frozen=True, kw_only=True)
class Programs:
    """Run hostile programs and mutants in the sandbox, and time a cabinet of 30 parts and 8
    joints.
    """

    mutations: int = 5000
    """Mutants of the guide's programs; some 20 ms each."""
    repeats: int = 9
    """Repetitions of each timing; the answer gives medians."""
    no_hostile: bool = False
    """Leave the hostile programs out; they take a minute."""
    seed: int = 0
    """Seed of the mutations."""


@dataclass(frozen=True, kw_only=True)
class Scoring:
    """Score candidates by a slow, unreliable server on this machine while physics runs."""

    wait: tuple[Literal["all", "bounded", "none"], ...] = ("all", "bounded", "none")
    """Ways of waiting; a row for each."""
    physics: tuple[Literal["pause", "native"], ...] = ("pause", "native")
    """A pause leaves the processor to drawing pictures, rollouts on all cores do not."""
    iterations: int = 6
    """Iterations of the search."""
    physics_s: float = 3.0
    """Physics of one iteration alone [s]."""
    delay_s: float = 3.0
    """How long the server takes for a call [s]; it answers eight at once."""
    failing: float = 0.1
    """Share of its calls that fail."""
    seed: int = 0
    """Seed of layouts and failures."""


@dataclass(frozen=True, kw_only=True)
class Verify:
    """Put faults into valid objects, and count those that the battery detects, names and
    repairs.
    """

    objects: int | None = None
    """Number of valid objects; by default all."""
    kind: tuple[str, ...] = ()
    """Kinds of faults; none takes all."""
    no_repair: bool = False
    """Detect and name only."""
    workers: int = 0
    """Processes; 0 takes all cores."""


@dataclass(frozen=True, kw_only=True)
class Battery:
    """Simulate the battery's runs of many objects at once, on all cores and on a GPU."""

    objects: int = 100
    """Number of objects; valid ones in up to four sizes."""
    engine: tuple[Literal["native", "warp"], ...] = ("native", "warp")
    """Engines that simulate them."""
    together: int = 16
    """Objects that share a model on the GPU."""


SUITES = {
    "programs": Suite(Programs, "benchmarks.programs:answer"),
    "verify": Suite(Verify, "benchmarks.verify:answer"),
    "battery": Suite(Battery, "benchmarks.battery:answer"),
    "scoring": Suite(Scoring, "benchmarks.scoring:answer"),
}
"""What `python -m benchmarks NAME` runs."""
