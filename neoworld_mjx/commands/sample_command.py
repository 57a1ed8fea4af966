"""Command `sample`: all the scenes that a photograph allows."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from ..errors import RunError
from ..names import Format
from .base_command import CommandResult, ConfiguredCommand

SAMPLES = "samples.npz"


@dataclass(frozen=True, kw_only=True)
class SampleCommand(ConfiguredCommand):
    """Draw scenes that a photograph allows, and count in how many of them every object rests.

    Poses, sizes, openings and the camera are drawn from the uncertainty of the alignment;
    densities, frictions and losses of joints from priors. `samples.npz` next to the scene contains
    all draws.
    """

    target: Positional[Path]
    """A run folder or a scene.json."""
    n: Annotated[int, arg(aliases=("-n",))] = 64
    """Number of draws."""
    seed: int = 0
    """Random seed."""
    export: Path | None = None
    """New or empty folder to which each draw that is kept is written as a scene."""
    format: UseAppendAction[tuple[Format, ...]] = ()
    """With --export: format to write; repeatable. Default: mjcf."""

    def run(self) -> CommandResult:
        """Draw, settle and check."""
        from ..environments.samples import sample
        from ..export.formats import write_formats
        from ..io.files import write_output
        from ..run_folder import run_options
        from ..spec import read_scene

        folder = self.export
        if folder is not None and (folder.is_file() or (folder.is_dir() and any(folder.iterdir()))):
            raise RunError(f"{folder} is not an empty folder: name a new folder")
        config, scene = self.load_config(), read_scene(self.target)
        options = config.refine
        if (self.target / "run.json").is_file() and self.config is None and not self.set:
            options = run_options(self.target, {}).refine
        samples = sample(scene, self.n, seed=self.seed, options=options)
        file = (self.target if self.target.is_dir() else self.target.parent) / SAMPLES
        samples.write(file)
        if folder is not None:
            for k in samples.kept.tolist():
                drawn, out = samples.scene(k), folder / f"{k:04d}"
                write_formats(drawn, out, self.format or ("mjcf",))
                write_output(out / "scene.json", drawn.to_json(), RunError)
        result: CommandResult = {
            "target": str(self.target),
            "verdict": samples.phrase(),
            "draws": len(samples),
            "stand": int(samples.stands.sum()),
            "kept": len(samples.kept),
            "refused": dict(Counter(reason for reason in samples.reasons if reason)),
            "file": str(file),
        }
        if folder is not None:
            result["exported"] = str(folder)
        if all(item.uncertainty is None for item in scene.objects):
            result["note"] = "the scene was not aligned: only densities, frictions and losses vary"
        return result

    def lines(self, result: CommandResult) -> list[str]:
        """Return the verdict and the files."""
        lines = [result["verdict"], f"wrote {result['file']}"]
        lines += [f"wrote {result['exported']}"] if "exported" in result else []
        return lines + ([f"note: {result['note']}"] if "note" in result else [])
