"""Command `export`: scenes and objects in the formats of other programs."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from ..errors import RunError, SpecError
from ..names import FORMATS, PREFERRED_FORMATS, Format, Simulator
from .base_command import CommandResult, ConfiguredCommand
from .result_lines import export_lines

if TYPE_CHECKING:
    from ..config import Config
    from ..spec import ObjectSpec, SceneSpec


@dataclass(frozen=True, kw_only=True)
class ExportCommand(ConfiguredCommand):
    """Export a scene or an object to a format or for a simulator, and list what is lost."""

    target: Positional[Path]
    """A run folder, a scene.json, a program (.py), a URDF, MJCF or glTF file."""
    out: Path
    """Output folder, new or empty."""
    format: UseAppendAction[tuple[Format, ...]] = ()
    """Format to write; repeatable. Default: all."""
    simulator: Annotated[Simulator | None, arg(name="for")] = None
    """Simulator for which files are written, by default in the formats that suit it best. For mjx,
    colliders are converted to supported ones."""
    floor: bool = False
    """Add an infinite floor plane at z = 0, or below the lowest free object (MJCF)."""
    overwrite: bool = False
    """Allow an output folder that is not empty."""

    def run(self) -> CommandResult:
        """Write the files."""
        from ..export.formats import collider_error, losses, write_formats

        if self.out.exists() and not self.out.is_dir():
            raise RunError(f"{self.out} is a file; name a folder")
        if self.out.is_dir() and any(self.out.iterdir()) and not self.overwrite:
            raise RunError(f"{self.out} is not empty: name a new folder, or use --overwrite")
        kinds = self.format or (PREFERRED_FORMATS[self.simulator] if self.simulator else FORMATS)
        mjx = self.simulator == "mjx"
        if mjx and "mjcf" not in kinds:
            raise SpecError("for mjx, MJCF is written: name no format, or mjcf among the formats")
        if self.floor and "mjcf" not in kinds:
            raise SpecError(
                "--floor is written to MJCF only: add --format mjcf, or a floor in the simulator"
            )
        config = self.load_config()
        described, notes = self._read(config)
        files = write_formats(
            described, self.out, kinds, simulator=self.simulator, floor=self.floor
        )
        result: CommandResult = {
            "target": str(self.target),
            "folder": str(self.out),
            "files": files,
            "lost": {kind: losses(kind, described) for kind in kinds},
        }
        if notes:
            result["notes"] = notes
        if mjx:
            result["collider_error_mm"] = round(1e3 * collider_error(described), 3)
        return result

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return export_lines(result)

    def _read(self, config: "Config") -> "tuple[SceneSpec | ObjectSpec, list[str]]":
        """Return the scene or object, and notes about losses on import.

        An object that its file fixes to the world is a scene, because objects are free.
        """
        if self.target.is_dir() or self.target.suffix == ".json":
            from ..spec import read_scene

            return read_scene(self.target), []
        if self.target.suffix == ".py":
            from ..verify.checking import build_patched

            built = build_patched(self.target, config.program).built
            if built.spec is None or not built.ok:
                errors = "; ".join(str(signal.message) for signal in built.signals)
                raise SpecError(f"{self.target} does not build: {errors}")
            return built.spec, []
        from ..export.importing import ImportedScene, import_file

        imported = import_file(self.target)
        if isinstance(imported, ImportedScene) or not imported.fixed_base:
            return imported.spec, list(imported.notes)
        return imported.scene, list(imported.notes)
