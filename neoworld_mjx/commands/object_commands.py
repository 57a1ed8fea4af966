"""Commands `check` and `build`, for single objects and scenes."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from ..errors import RunError, SpecError
from .base_command import CommandResult, ConfiguredCommand
from .result_lines import build_lines, object_check_lines, scene_check_lines

if TYPE_CHECKING:
    from ..program import BuildResult
    from ..spec import SceneSpec


@dataclass(frozen=True, kw_only=True)
class CheckCommand(ConfiguredCommand):
    """Check a scene or an object, and print each check with its value and threshold."""

    target: Positional[Path]
    """A run folder, a scene.json, a program (.py), a URDF, MJCF or glTF file."""
    fixed_base: bool = False
    """Fix the object's base, and check only its joints."""
    repair: bool = False
    """Repair failed checks by their measured values. The patch of a program is written next to the
    program."""
    out: Path | None = None
    """With --repair: output folder for the repaired object, in every format."""

    def run(self) -> CommandResult:
        """Check the scene or the object."""
        config = self.load_config()
        notes: list[str] = []
        scene: SceneSpec | None = None
        from ..export.importing import FILES, USD, ImportedScene, import_file

        suffix = self.target.suffix.lower()
        imported = import_file(self.target) if suffix in (*FILES, *USD) else None
        if isinstance(imported, ImportedScene):
            scene, notes = imported.spec, list(imported.notes)
        elif imported is not None or suffix == ".py":
            from ..verify.checking import check_object

            return check_object(
                self.target,
                config,
                imported=imported,
                fixed_base=self.fixed_base,
                repair=self.repair,
                out=self.out,
            )
        if self.repair or self.fixed_base or self.out is not None:
            raise SpecError(f"{self.target}: a scene cannot be repaired here; use refine")
        from ..measure import measured, scene_checks
        from ..spec import read_scene

        measure = measured(scene or read_scene(self.target), config.refine)
        checks = scene_checks(measure, config.refine)
        return {
            "target": str(self.target),
            **({"notes": notes} if notes else {}),
            "passed": all(check.passed for check in checks),
            "checks": [check.model_dump() for check in checks],
            **measure.model_dump(),
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        if "movable" in result:
            return scene_check_lines(result)
        return object_check_lines(result, self.listings(result))

    def listings(self, result: CommandResult) -> list[str]:
        """Return the output and the signals of the object's program."""
        return _listings(self.target, result)


@dataclass(frozen=True, kw_only=True)
class BuildCommand(ConfiguredCommand):
    """Convert an object's program, URDF or MJCF file into every format and images."""

    program: Positional[Path]
    """The program (.py), or a URDF or MJCF file with one object."""
    out: Path
    """Output folder, new or empty."""
    overwrite: bool = False
    """Allow an output folder that is not empty."""

    def run(self) -> CommandResult:
        """Build the program and write the object in every format."""
        from ..verify.patched import build_patched, write_built

        out = self.out
        if out.exists() and not out.is_dir():
            raise RunError(f"{out} is a file; name a folder")
        if out.is_dir() and any(out.iterdir()) and not self.overwrite:
            raise RunError(f"{out} is not empty: name a new folder, or use --overwrite")
        options = self.load_config().program
        if self.program.suffix.lower() != ".py":
            return self._convert()
        patched = build_patched(self.program, options)
        built = patched.built
        result: CommandResult = {"passed": built.ok, "signals": _signals(built)}
        if built.printed:
            result["printed"] = built.printed
        if built.spec is None or not built.ok:
            return result
        if patched.patch is not None:
            result["overlay"] = {
                "changes": list(patched.patch.changes()),
                "stale": list(patched.stale),
            }
        write_built(patched, out)
        return {"object": built.spec.name, "folder": str(out), **result}

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return build_lines(result, self.listings(result))

    def listings(self, result: CommandResult) -> list[str]:
        """Return the output and the signals of the program."""
        return _listings(self.program, result)

    def _convert(self) -> CommandResult:
        """Convert a URDF or MJCF file."""
        from ..verify.checking import import_object
        from ..verify.patched import spec_files, write_files

        imported = import_object(self.program)
        write_files(spec_files(imported.spec), self.out)
        return {
            "object": imported.spec.name,
            "folder": str(self.out),
            "passed": True,
            "notes": list(imported.notes),
        }


def _signals(built: "BuildResult") -> list[dict[str, Any]]:
    return [{"code": s.code, **s.model_dump(exclude_defaults=True)} for s in built.signals]


def _listings(program: Path, result: CommandResult) -> list[str]:
    """Format the output and the signals of a program."""
    from ..checks.signals import Signal
    from ..verify.patched import listings, read_program

    if "signals" not in result:
        return []
    signals = [Signal.model_validate(entry) for entry in result["signals"]]
    return listings(result.get("printed", ""), signals, program, read_program(program))
