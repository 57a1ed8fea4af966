"""What the commands of `neoworld` take: one dataclass a command."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitSubcommandPrefixes, Positional, UseAppendAction, arg, subcommand

from .engines import ENGINES, EngineChoice, EngineName

Step = Literal["parse", "program", "verify", "compose", "refine", "export"]


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of every command."""

    json: bool = False
    """Print one JSON object on stdout, and everything else on stderr."""
    quiet: bool = False
    """Say nothing about progress."""


@dataclass(frozen=True, kw_only=True)
class Configured(Common):
    """Options of the commands that take a configuration."""

    config: Path | None = None
    """YAML of options; only what differs from the defaults."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """One option as KEY=VALUE, such as --set refine.cem.population=64; may be repeated."""


@dataclass(frozen=True, kw_only=True)
class Reconstruct(Configured):
    """Turn a photograph into a scene that simulates."""

    photo: Positional[Path]
    """The photograph."""
    out: Path
    """Run folder to write; a new or empty one, or a run to go on with."""
    provider: str | None = None
    """Who answers: auto, anthropic, openai, replay or mailbox."""
    engine: EngineChoice | None = None
    """Physics engine of the refine step."""
    seed: int | None = None
    """Seed of the search."""
    until: Step | None = None
    """Stop after this step."""
    resume: bool = False
    """Go on with the run in --out: keep the finished steps whose inputs have not changed."""
    start: Annotated[Step | None, arg(name="from")] = None
    """Do this step of the run in --out again, and all after it."""
    overwrite: bool = False
    """Replace the run in --out."""
    record: Path | None = None
    """Record the models' answers on this tape, and take those it has from it."""
    tape: UseAppendAction[tuple[Path, ...]] = ()
    """Tape of answers, or folder of tapes, to look in before those of the package; may be repeated."""
    mailbox: Path | None = None
    """Folder of requests and answers, for the provider mailbox."""


@dataclass(frozen=True, kw_only=True)
class Refine(Configured):
    """Refine the composed scene of a run again, and export it; the steps before are kept.

    Without --config and --set the options are those that the run was made with.
    """

    folder: Positional[Path]
    """The run folder."""
    engine: EngineChoice | None = None
    """Physics engine."""
    seed: int | None = None
    """Seed of the search."""


@dataclass(frozen=True, kw_only=True)
class Check(Configured):
    """Check a scene or an object, wherever it comes from: every verdict with its number and threshold."""

    target: Positional[Path]
    """A run folder, a scene.json, a program (.py), a URDF or an MJCF file."""
    fixed_base: bool = False
    """The object stays fastened where it is: try only its joints."""
    repair: bool = False
    """Mend what numbers tell how to mend; of a program the patch is kept beside it."""
    out: Path | None = None
    """With --repair: folder to write the mended object into, in every format."""


@dataclass(frozen=True, kw_only=True)
class Build(Configured):
    """Turn an object's program into URDF, USD, MJCF and pictures."""

    program: Positional[Path]
    """The program (.py)."""
    out: Path
    """Folder to write; a new or empty one."""
    overwrite: bool = False
    """Write into a folder that is not empty."""
    watch: bool = False
    """Build again whenever the program is saved, until Ctrl-C; a line tells of each time."""


@dataclass(frozen=True, kw_only=True)
class Render(Configured):
    """Take a picture of a scene."""

    target: Positional[Path]
    """A run folder or a scene.json."""
    out: Path | None = None
    """PNG file to write; by default render.png beside the scene."""
    width: int | None = None
    """Of the picture, in pixels."""


@dataclass(frozen=True, kw_only=True)
class Report(Common):
    """Write report.html of a run, finished or not."""

    folder: Positional[Path]
    """The run folder."""


@dataclass(frozen=True, kw_only=True)
class Sweep(Common):
    """Refine scenes with every combination of some options' values, with several seeds."""

    plan: Positional[Path]
    """YAML that names scenes, base options, axes and seeds."""
    out: Path
    """Folder to write results.parquet, table.md and sweep.json into; a new or empty one."""
    resume: bool = False
    """Go on with the sweep in --out: keep the runs that are there."""
    overwrite: bool = False
    """Replace the sweep in --out."""


@dataclass(frozen=True, kw_only=True)
class Ablate(Common):
    """Refine scenes with a base and named changes of it, and tell their differences."""

    plan: Positional[Path]
    """YAML that names scenes, base options, variants and seeds."""
    out: Path
    """Folder to write results.parquet, table.md and sweep.json into; a new or empty one."""
    resume: bool = False
    """Go on with the ablation in --out: keep the runs that are there."""
    overwrite: bool = False
    """Replace the ablation in --out."""


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """Say what is installed here and what can run."""


@dataclass(frozen=True, kw_only=True)
class BenchPhysics(Common):
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
    """Of scenes and layouts."""
    chart: Path | None = None
    """SVG file to draw the growth of cost into."""


@dataclass(frozen=True, kw_only=True)
class BenchKernels(Common):
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
    """Of scenes and layouts."""
    pairs: int = 10_000
    """Random pairs of solids over which sampled depths are held against exact ones; 0 for none."""
    table: Path | None = None
    """JSON file of measured devices to enter this one into: what `pair_depth` chooses by."""


@dataclass(frozen=True, kw_only=True)
class BenchAgreement(Common):
    """Compare engines with MuJoCo on recompiled scenes: fields, bits, first steps, verdicts."""

    scene: tuple[str, ...] = ()
    """Of stack, cluttered, cabinet, container, leaning and mixed; none takes all six."""
    engine: tuple[EngineName, ...] = ("native",)
    """Engines whose verdicts are compared."""
    layouts: int = 64
    """Candidates of each scene."""
    seed: int = 0
    """Of the layouts."""


@dataclass(frozen=True, kw_only=True)
class BenchPrograms(Common):
    """Run hostile programs and mutants in the sandbox, and time a cabinet of 30 parts and 8 joints."""

    mutations: int = 5000
    """Mutants of the guide's programs; some 20 ms each."""
    repeats: int = 9
    """Of each timing; medians are told."""
    no_hostile: bool = False
    """Leave the hostile programs out; they take a minute."""
    seed: int = 0
    """Of the mutations."""


@dataclass(frozen=True, kw_only=True)
class BenchRefine(Configured):
    """Refine scenes with known truth from noisy starts, beside Algorithm 1, random search and CMA-ES."""

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


@dataclass(frozen=True, kw_only=True)
class BenchScoring(Common):
    """Score candidates by a slow, unreliable server on this machine while physics runs."""

    wait: tuple[Literal["all", "bounded", "none"], ...] = ("all", "bounded", "none")
    """Ways of waiting; a row for each."""
    physics: tuple[Literal["pause", "native"], ...] = ("pause", "native")
    """A pause leaves the processor to drawing pictures, rollouts on all cores do not."""
    iterations: int = 6
    """Of the search."""
    physics_s: float = 3.0
    """Physics of one iteration alone [s]."""
    delay_s: float = 3.0
    """How long the server takes for a call [s]; it answers eight at once."""
    failing: float = 0.1
    """Share of its calls that fail."""
    seed: int = 0
    """Of layouts and failures."""


@dataclass(frozen=True, kw_only=True)
class BenchVerify(Common):
    """Put faults into sound objects: what the battery finds, names and mends."""

    objects: int | None = None
    """How many sound objects; by default all."""
    kind: tuple[str, ...] = ()
    """Kinds of faults; none takes all."""
    no_repair: bool = False
    """Find and name only."""
    workers: int = 0
    """Processes; 0 takes all cores."""


@dataclass(frozen=True, kw_only=True)
class BenchBattery(Common):
    """Simulate the battery's runs of many objects at once, on all cores and on a GPU."""

    objects: int = 100
    """How many; sound ones in up to four sizes."""
    engine: tuple[Literal["native", "warp"], ...] = ("native", "warp")
    """What simulates them."""
    together: int = 16
    """Objects that share a model on the GPU."""


@dataclass(frozen=True, kw_only=True)
class BenchChart(Common):
    """Draw the growth of cost from the JSON that `bench run physics` printed."""

    rows: Positional[Path]
    """File with what `bench run physics --json` printed."""
    out: Path
    """SVG file to write."""
    core: bool = False
    """Draw processor time, which a busy machine does not change."""


@dataclass(frozen=True, kw_only=True)
class BenchRun:
    """Run a benchmark."""

    suite: (
        Annotated[BenchPhysics, subcommand("physics")]
        | Annotated[BenchKernels, subcommand("kernels")]
        | Annotated[BenchAgreement, subcommand("agreement")]
        | Annotated[BenchRefine, subcommand("refine")]
        | Annotated[BenchScoring, subcommand("scoring")]
        | Annotated[BenchVerify, subcommand("verify")]
        | Annotated[BenchBattery, subcommand("battery")]
        | Annotated[BenchPrograms, subcommand("programs")]
    )


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Measure speed and agreement of engines."""

    task: Annotated[BenchRun, subcommand("run")] | Annotated[BenchChart, subcommand("chart")]

    @property
    def inner(
        self,
    ) -> (
        BenchPhysics
        | BenchKernels
        | BenchAgreement
        | BenchRefine
        | BenchScoring
        | BenchVerify
        | BenchBattery
        | BenchPrograms
        | BenchChart
    ):
        """What was asked for, at the end of the nested commands."""
        return self.task.suite if isinstance(self.task, BenchRun) else self.task

    @property
    def json(self) -> bool:
        """See Common."""
        return self.inner.json

    @property
    def quiet(self) -> bool:
        """See Common."""
        return self.inner.quiet


Command = (
    Annotated[Reconstruct, subcommand("reconstruct")]
    | Annotated[Refine, subcommand("refine")]
    | Annotated[Check, subcommand("check")]
    | Annotated[Build, subcommand("build")]
    | Annotated[Render, subcommand("render")]
    | Annotated[Report, subcommand("report")]
    | Annotated[Sweep, subcommand("sweep")]
    | Annotated[Ablate, subcommand("ablate")]
    | Annotated[Doctor, subcommand("doctor")]
    | OmitSubcommandPrefixes[Annotated[Bench, subcommand("bench")]]
)
