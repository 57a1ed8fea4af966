"""The table of developer suites: the options of each, and the function that runs it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from neoworld_bench.suites import Suite
from tyro.conf import UseAppendAction


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
    neighbours: int = 0
    """Processes that keep the cores busy beside the hostile programs."""
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


@dataclass(frozen=True, kw_only=True)
class Templates:
    """Build every template at its defaults and as drawn, check it, and run the battery on it."""

    name: tuple[str, ...] = ()
    """Templates; none takes all."""
    seeds: int = 3
    """Drawn instances of each, besides its defaults."""
    sheet: Path | None = None
    """Picture to draw of all of them, at rest and opened."""
    workers: int = 0
    """Processes; 0 takes all cores."""


@dataclass(frozen=True, kw_only=True)
class Readers:
    """Let foreign programs read and simulate exported objects and the example's scene, beside what
    is meant and how it moves in MuJoCo.

    `uv` makes their environments, which contradict each other; some are gigabytes. Without
    `--reader` all of them run, some 40 minutes on a core.
    """

    reader: UseAppendAction[tuple[str, ...]] = ()
    """Program; may be repeated, none takes all."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Program of examples/objects; may be repeated, none takes all."""
    scene: Path | None = None
    """Run folder of the scene; by default the bundled example is reconstructed."""
    no_scene: bool = False
    """Leave the scene and its objects out."""
    assets: Path | None = None
    """Folder with further objects, <name>/model.xml."""
    figure: Path | None = None
    """Figure of benchmarks/figures whose table to write."""


@dataclass(frozen=True, kw_only=True)
class RoundTrips:
    """Write objects as MJCF, URDF and USD, read them again, and compare what came back."""

    templates: int = 24
    """Templates, one drawn instance of each; beside them go all of examples/objects."""
    random: int = 24
    """Random trees with every kind of joint."""
    assets: Path | None = None
    """Folder with further objects, <name>/model.xml."""
    seed: int = 0
    """Seed of the templates and trees."""


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Read generated hostile inputs of every kind, each watched, in a process that may die."""

    count: int = 1000
    """Number of inputs; some 100 ms each."""
    seed: int = 0
    """Seed of the first; the others follow."""


@dataclass(frozen=True, kw_only=True)
class Faults:
    """Strike runs by faults at random moments, and go on with them."""

    count: int = 200
    """Number of faults; some seconds each."""
    seed: int = 0
    """Seed of the first; the others follow."""
    until: str = "verify"
    """Last step of the runs; refine and export are struck by an engine that returns NaN, too."""
    photo: str = "coffee.png"
    """A photograph in `examples`; microwave.jpg and drawers.png show things with joints."""


@dataclass(frozen=True, kw_only=True)
class Decisions:
    """Check what refinements wrote, of the examples and of disturbed scenes, and compare."""

    scenes: int = 50
    """Number of disturbed scenes; some seconds each."""
    seed: int = 0
    """Seed of the first; the others follow."""


@dataclass(frozen=True, kw_only=True)
class Composing:
    """Compose the bundled photographs, and again without refit and without settling."""

    example: tuple[str, ...] = ()
    """Bundled photographs; none takes all."""


@dataclass(frozen=True, kw_only=True)
class Costs:
    """Estimate tokens and dollars of the bundled examples from their requests and answers."""

    model: tuple[str, ...] = (
        "claude-haiku-5-5",
        "claude-sonnet-5-5",
        "claude-opus-5-5",
        "gpt-6-sol",
    )
    """Models of the table of prices."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Open a scene's page in a headless browser, and count frames while the view is turned."""

    scene: Path = Path("benchmarks/neoworld_bench/photographs/real/coffee.json")
    """A run folder, a scene.json or a program."""
    seconds: float = 6.0
    """How long the view is turned [s]."""
    visits: int = 3
    """Visits of a new browser."""


SUITES = {
    "composing": Suite(Composing, "benchmarks.composing:answer"),
    "frames": Suite(Frames, "benchmarks.frames:answer"),
    "costs": Suite(Costs, "benchmarks.costs:answer"),
    "decisions": Suite(Decisions, "benchmarks.decisions:answer"),
    "faults": Suite(Faults, "benchmarks.faults:answer"),
    "inputs": Suite(Inputs, "benchmarks.inputs:answer"),
    "readers": Suite(Readers, "benchmarks.readers:answer"),
    "round-trips": Suite(RoundTrips, "benchmarks.round_trips:answer"),
    "programs": Suite(Programs, "benchmarks.programs:answer"),
    "verify": Suite(Verify, "benchmarks.verify:answer"),
    "battery": Suite(Battery, "benchmarks.battery:answer"),
    "templates": Suite(Templates, "benchmarks.templates:answer"),
    "scoring": Suite(Scoring, "benchmarks.scoring:answer"),
}
"""What `python -m benchmarks NAME` runs."""
