"""Commands `reconstruct`, `refine` and `report`, which work on run folders, and `examples`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_args

from tyro.conf import Positional, UseAppendAction, arg

from ..engines import EngineChoice
from ..errors import ConfigError
from ..names import Step
from ..quantities import count
from .base_command import (
    EVIDENCE,
    Command,
    CommandResult,
    ConfiguredCommand,
    EvidenceFlags,
    check_photo,
)
from .result_lines import DETAILS, run_lines


@dataclass(frozen=True, kw_only=True)
class ReconstructCommand(EvidenceFlags, ConfiguredCommand):
    """Reconstruct a simulation-ready scene from a photograph."""

    inputs: ClassVar = ("config", *EVIDENCE)

    photo: Positional[Path]
    """The photograph, or a name that `neoworld examples` lists."""
    out: Path
    """Run folder: new, empty, or a run to continue."""
    further: Annotated[UseAppendAction[tuple[Path, ...]], arg(name="photo")] = ()
    """A further photograph of the same scene; repeatable."""
    provider: str | None = None
    """Source of the models' responses: auto, anthropic, openai, replay or mailbox."""
    model: str | None = None
    """Name of the model that plays all roles, as its provider calls it."""
    fast: bool = False
    """Ask for each response once, without critics: fewer requests, but more errors stay."""
    engine: EngineChoice | None = None
    """Physics engine of the refine step."""
    seed: int | None = None
    """Seed of the search."""
    until: Step | None = None
    """Stop after this step."""
    resume: bool = False
    """Continue the run in --out, reusing finished steps with unchanged inputs."""
    start: Annotated[Step | None, arg(name="from")] = None
    """Repeat this step of the run in --out, and all later steps."""
    overwrite: bool = False
    """Replace the run in --out."""
    record: Path | None = None
    """Write the models' responses to this file of recorded responses (a tape), and reuse responses
    that it already contains."""
    tape: UseAppendAction[tuple[Path, ...]] = ()
    """File of recorded responses (a tape), or a folder of tapes, searched before the bundled tapes;
    repeatable."""
    mailbox: Path | None = None
    """Folder into which requests are written and from which responses are read, for the provider
    mailbox."""

    def check_inputs(self) -> None:
        """Check the photographs, too."""
        super().check_inputs()
        for photo in (self.photo, *self.further):
            check_photo(photo)

    def run(self) -> CommandResult:
        """Run the five steps."""
        from ..cache import keep_compilations
        from ..config import WITHOUT_CRITICS, Role
        from ..pipeline import reconstruct
        from ..pipeline.bundled_examples import photo_of

        flags: dict[str, Any] = {
            "provider": self.provider,
            "refine.rollout.engine": self.engine,
            "seed": self.seed,
            **{f"mllm.{role}.model": self.model for role in get_args(Role)},
        }
        for group, options in WITHOUT_CRITICS.items() if self.fast else ():
            flags |= {f"{group}.{key}": value for key, value in options.items()}
        config = self.load_config(flags)
        keep_compilations()
        result = reconstruct(
            photo_of(self.photo),
            self.out,
            config,
            until=self.until,
            resume=self.resume,
            start=self.start,
            overwrite=self.overwrite,
            record=self.record,
            mailbox=self.mailbox,
            tapes=self.tape,
            evidence=self.stated(self.further),
        )
        return result.summary()

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return run_lines(result)


@dataclass(frozen=True, kw_only=True)
class RefineCommand(EvidenceFlags, ConfiguredCommand):
    """Refine the composed scene of a run again, and export it; earlier steps are reused.

    Without --config and --set, the options of the run are used. With --from, FOLDER is a new folder
    for the scene of another method. The meshes of this scene are put on their supports, aligned
    with the photograph (if --photo is given), settled, and exported with colliders.
    """

    inputs: ClassVar = ("source", "photo", "config", *EVIDENCE)

    folder: Positional[Path]
    """The run folder; with --from, a new folder to write."""
    source: Annotated[Path | None, arg(name="from")] = None
    """Scene of another method: a glTF file, or a poses.json next to its meshes."""
    photo: Path | None = None
    """With --from: the photograph of the scene."""
    scale: float | None = None
    """With --from: factor of all lengths in the file, such as 0.01 if it is in centimeters."""
    engine: EngineChoice | None = None
    """Physics engine."""
    seed: int | None = None
    """Seed of the search."""

    def run(self) -> CommandResult:
        """Refine and export."""
        from ..cache import keep_compilations
        from ..pipeline import refine_again

        keep_compilations()
        if self.source is not None:
            return self._rescue(self.source)
        stated = "evidence, such as --camera," if self.stated() is not None else None
        given = {"--photo": self.photo, "--scale": self.scale, str(stated): stated}
        for flag, value in given.items():
            if value is not None:
                raise ConfigError(
                    f"{flag} belongs to --from: {self.folder} has its photograph and evidence; "
                    "change them by reconstruct --resume"
                )
        overrides: dict[str, Any] = {}
        if self.seed is not None:
            overrides["seed"] = self.seed
        if self.engine is not None:
            overrides["refine"] = {"rollout": {"engine": self.engine}}
        config = None
        if self.config is not None or self.set:
            config = self.load_config({"refine.rollout.engine": self.engine, "seed": self.seed})
        return refine_again(self.folder, config, overrides).summary()

    def _rescue(self, source: Path) -> CommandResult:
        from ..pipeline.rescue import rescue_file

        config = self.load_config({"refine.rollout.engine": self.engine, "seed": self.seed})
        return rescue_file(
            source,
            self.folder,
            config,
            photo=self.photo,
            evidence=self.stated(),
            scale=self.scale,
        ).summary()

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return run_lines(result)


@dataclass(frozen=True, kw_only=True)
class ReportCommand(Command):
    """Write report.html of a run, finished or not."""

    inputs: ClassVar = ("folder",)

    folder: Positional[Path]
    """The run folder."""

    def run(self) -> CommandResult:
        """Write the report."""
        from ..run_folder import read_run, verdict_line
        from ..view.report.run_report import write_report

        report = write_report(self.folder)
        return {"report": str(report), "verdict": verdict_line(read_run(self.folder)["metrics"])}

    def lines(self, result: CommandResult) -> list[str]:
        """Return the verdict, and the path of the report."""
        return [result["verdict"], f"report: {result['report']}"]


@dataclass(frozen=True, kw_only=True)
class ExamplesCommand(Command):
    """List the bundled photographs, which `neoworld reconstruct NAME --out DIR` takes."""

    def run(self) -> CommandResult:
        """Return the name and description of each photograph."""
        from ..pipeline.bundled_examples import bundled_examples

        examples = [
            {"name": name, **example.model_dump(mode="json")}
            for name, example in bundled_examples().items()
        ]
        return {"examples": examples}

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        rows = [
            f"{example['name']}: {count(example['objects'], 'object')}, "
            f"{count(example['joints'], 'joint')}; {example['shows']} ({example['licence']})"
            for example in result["examples"]
        ]
        return [
            *rows,
            f"next: neoworld reconstruct NAME --out DIR; credits and files: {DETAILS[9:]}",
        ]
