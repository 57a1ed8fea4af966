"""What the commands of `neoworld` take: one dataclass a command."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from tyro.conf import OmitSubcommandPrefixes, Positional, UseAppendAction, arg, subcommand

from .bench.suites import SUITES, Suite
from .engines import EngineChoice

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
class BenchChart(Common):
    """Draw the growth of cost from the JSON that `bench run physics` printed."""

    rows: Positional[Path]
    """File with what `bench run physics --json` printed."""
    out: Path
    """SVG file to write."""
    core: bool = False
    """Draw processor time, which a busy machine does not change."""


def suite_commands(suites: Mapping[str, Suite]) -> Any:
    """Return the union of the commands that run the suites of a table, for tyro."""
    commands = []
    for name, suite in suites.items():
        bases = (suite.options, Configured if suite.configured else Common)
        fields = {"__doc__": suite.options.__doc__, "__module__": __name__, "suite": suite}
        command = dataclass(frozen=True, kw_only=True)(type(f"Bench{name.title()}", bases, fields))
        commands.append(Annotated[command, subcommand(name)])
    return Union[tuple(commands)]  # noqa: UP007


if TYPE_CHECKING:
    BenchSuite = Any
else:
    BenchSuite = suite_commands(SUITES)


@dataclass(frozen=True, kw_only=True)
class BenchRun:
    """Run a benchmark."""

    suite: BenchSuite


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Measure speed and agreement of engines, and the quality of refinement."""

    task: Annotated[BenchRun, subcommand("run")] | Annotated[BenchChart, subcommand("chart")]

    @property
    def inner(self) -> Any:
        """The command at the end of the nested ones."""
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
