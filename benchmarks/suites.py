"""Developer suites: their options and functions."""

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
    """Repetitions of each timing; medians are reported."""
    no_hostile: bool = False
    """Skip the hostile programs, which take a minute."""
    neighbours: int = 0
    """Processes that keep the cores busy while hostile programs run."""
    seed: int = 0
    """Seed of the mutations."""


@dataclass(frozen=True, kw_only=True)
class Scoring:
    """Score candidates by a slow, unreliable server on this machine while physics runs."""

    wait: tuple[Literal["all", "bounded", "none"], ...] = ("all", "bounded", "none")
    """Ways of waiting, with a row for each."""
    physics: tuple[Literal["pause", "native"], ...] = ("pause", "native")
    """Physics: a pause leaves the processor to rendering; native rollouts use all cores."""
    iterations: int = 6
    """Iterations of the search."""
    physics_s: float = 3.0
    """Duration of physics alone in one iteration [s]."""
    delay_s: float = 3.0
    """Time of the server for a call [s]; it serves eight at once."""
    failing: float = 0.1
    """Share of its calls that fail."""
    seed: int = 0
    """Seed of layouts and failures."""


@dataclass(frozen=True, kw_only=True)
class Verify:
    """Inject faults into valid objects, and count those that the object tests detect, name and
    repair.
    """

    objects: int | None = None
    """Number of valid objects; all by default."""
    kind: tuple[str, ...] = ()
    """Kinds of faults; all by default."""
    no_repair: bool = False
    """Detect and name faults only."""
    workers: int = 0
    """Processes; 0 for all cores."""


@dataclass(frozen=True, kw_only=True)
class Battery:
    """Run the object tests of many objects at once, on all cores and on a GPU."""

    objects: int = 100
    """Number of objects: valid objects in up to four sizes."""
    engine: tuple[Literal["native", "warp"], ...] = ("native", "warp")
    """Engines that simulate them."""
    together: int = 16
    """Objects that share a model on the GPU."""


@dataclass(frozen=True, kw_only=True)
class Templates:
    """Build every template at its defaults and at random parameters, and run all checks and object
    tests.
    """

    name: tuple[str, ...] = ()
    """Templates; all by default."""
    seeds: int = 3
    """Random instances of each, in addition to its defaults."""
    sheet: Path | None = None
    """Contact sheet to write of all templates, at rest and opened."""
    workers: int = 0
    """Processes; 0 for all cores."""


@dataclass(frozen=True, kw_only=True)
class Readers:
    """Read and simulate exported objects and a scene in other simulators, and compare them with the
    spec and with MuJoCo.

    `uv` creates their environments, some of them gigabytes. Without `--reader` all of them run,
    which takes 40 minutes on a core.
    """

    reader: UseAppendAction[tuple[str, ...]] = ()
    """Program; may be repeated; all by default."""
    object: UseAppendAction[tuple[str, ...]] = ()
    """Program of examples/objects; may be repeated; all by default."""
    scene: Path | None = None
    """Run folder of the scene; by default the bundled example is reconstructed."""
    no_scene: bool = False
    """Skip the scene and its objects."""
    assets: Path | None = None
    """Folder of further objects, <name>/model.xml."""
    figure: Path | None = None
    """Figure of benchmarks/figures whose table is written."""


@dataclass(frozen=True, kw_only=True)
class RoundTrips:
    """Write objects as MJCF, URDF and USD, read them again, and compare."""

    templates: int = 24
    """Templates, one random instance of each, in addition to all of examples/objects."""
    random: int = 24
    """Number of random trees with every kind of joint."""
    assets: Path | None = None
    """Folder of further objects, <name>/model.xml."""
    seed: int = 0
    """Seed of the templates and trees."""


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Read generated hostile inputs of every kind in a monitored process that may crash."""

    count: int = 1000
    """Number of inputs; about a second each."""
    seed: int = 0
    """Seed of the first; the others are consecutive."""
    log: Path | None = None
    """File to which each outcome is appended; a repeated command skips those that are in it."""


@dataclass(frozen=True, kw_only=True)
class Faults:
    """Inject faults into runs at random moments, and resume the runs."""

    count: int = 200
    """Number of faults; some seconds each."""
    seed: int = 0
    """Seed of the first; the others are consecutive."""
    until: str = "verify"
    """Last step of the runs; faults of refine and export include an engine that returns NaN."""
    photo: str = "coffee.png"
    """Photograph in `examples`; microwave.jpg and drawers.png show articulated objects."""
    log: Path | None = None
    """File to which each outcome is appended; a repeated command skips those that are in it."""


@dataclass(frozen=True, kw_only=True)
class Decisions:
    """Compare the verdicts of `check` and `refine` on the examples and on perturbed scenes."""

    scenes: int = 50
    """Number of perturbed scenes; some seconds each."""
    seed: int = 0
    """Seed of the first; the others are consecutive."""


@dataclass(frozen=True, kw_only=True)
class Composing:
    """Compose the bundled photographs with all steps, without refit and without settling."""

    example: tuple[str, ...] = ()
    """Bundled photographs; all by default."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Open a scene's page in a headless browser, and count frames while the view rotates."""

    scene: Path = Path("benchmarks/neoworld_bench/photographs/real/coffee.json")
    """A run folder, a scene.json or a program."""
    seconds: float = 6.0
    """Duration of the rotation [s]."""
    visits: int = 3
    """Number of visits, each in a new browser."""


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """Change one token of a module at a time, and see whether its direct tests notice.

    Needs the extra `mutation`. Prints each mutant as it is tried, then the score.
    """

    module: UseAppendAction[tuple[str, ...]] = ()
    """Module of benchmarks/mutation.yaml, by its path; may be repeated; all by default."""
    sample: int = 400
    """Number of mutants, drawn from all; 0 tries all, some ten thousand."""
    seed: int = 0
    """Seed of the sample."""
    workers: int = 1
    """Processes, each with a copy of the repository and one core."""
    log: Path | None = None
    """File to which each mutant is appended; a repeated command skips those that are in it."""
    skip_failing: bool = False
    """Leave out modules whose tests fail without a mutation on this machine, and name them."""


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """Count right and wrong cameras of responses that the parse notices in rendered pictures.

    Right: the true camera, and that of a noisy response. Wrong: a field of view that is 12 to 16
    degrees off, and a pitch that is 4.6 degrees off. Five minutes on two cores.
    """

    scenes: int = 30
    """Number of scenes of the data set, in their order."""
    photos: int = 40
    """Number of the scenes of `bench run photos`."""
    responses: int = 2
    """Responses per scene, each with its own noise."""


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Count the 90 % intervals of aligned objects that hold the truth, over rendered scenes.

    Initial scenes have all errors of responses; nothing is searched. A quarter of an hour on two
    cores.
    """

    scenes: int = 30
    """Number of scenes of the data set, in their order."""
    starts: int = 3
    """Initial scenes of each; those with odd numbers are the evaluation half."""
    workers: int = 2
    """Processes."""


SUITES = {
    "cameras": Suite(Cameras, "benchmarks.cameras:run_suite"),
    "coverage": Suite(Coverage, "benchmarks.coverage:run_suite"),
    "composing": Suite(Composing, "benchmarks.composing:run_suite"),
    "frames": Suite(Frames, "benchmarks.frames:run_suite"),
    "decisions": Suite(Decisions, "benchmarks.decisions:run_suite"),
    "faults": Suite(Faults, "benchmarks.faults:run_suite"),
    "mutation": Suite(Mutation, "benchmarks.mutation:run_suite"),
    "inputs": Suite(Inputs, "benchmarks.inputs:run_suite"),
    "readers": Suite(Readers, "benchmarks.readers:run_suite"),
    "round-trips": Suite(RoundTrips, "benchmarks.round_trips:run_suite"),
    "programs": Suite(Programs, "benchmarks.programs:run_suite"),
    "verify": Suite(Verify, "benchmarks.verify:run_suite"),
    "battery": Suite(Battery, "benchmarks.battery:run_suite"),
    "templates": Suite(Templates, "benchmarks.templates:run_suite"),
    "scoring": Suite(Scoring, "benchmarks.scoring:run_suite"),
}
"""Suites that `python -m benchmarks NAME` runs."""
