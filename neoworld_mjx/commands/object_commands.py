"""Commands `check`, `template` and `export`, for objects and scenes."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, UseAppendAction, arg

from ..errors import RunError, SpecError
from ..names import FORMATS, PREFERRED_FORMATS, Format, Simulator
from ..quantities import count
from .base_command import Command, CommandResult, ConfiguredCommand
from .result_lines import export_lines, object_check_lines, scene_check_lines, wrapped

if TYPE_CHECKING:
    from ..config import Config, RefineOptions
    from ..spec import SceneSpec


@dataclass(frozen=True, kw_only=True)
class CheckCommand(ConfiguredCommand):
    """Check a scene or an object, and print each check with its value and threshold.

    A run folder is checked with the options of the run, unless --config or --set is given.
    """

    target: Positional[Path]
    """A run folder, a scene.json, an object's folder, a program (.py), a URDF, MJCF or glTF
    file."""
    fixed_base: bool = False
    """Fix the object's base, and check only its joints."""
    repair: bool = False
    """Repair failed checks by their measured values. The patch of a program is written next to the
    program."""
    out: Path | None = None
    """With --repair: output folder for the repaired object, in every format."""
    samples: int = 0
    """Number of scenes that the photograph allows, in which an aligned scene is also checked."""

    def run(self) -> CommandResult:
        """Check the scene or the object."""
        config = self.load_config()
        if self.samples < 0:
            raise SpecError(f"--samples {self.samples}: name a positive number of draws")
        from ..export.importing import ImportedScene
        from ..verify.checking import check_object
        from ..verify.read_target import read_target

        alone = self.repair or self.fixed_base
        target = read_target(self.target, config.program, alone=alone)
        if isinstance(target, ImportedScene):
            if alone or self.out is not None:
                raise SpecError(f"{self.target}: a scene cannot be repaired here; use refine")
            return self._check_scene(target.spec, target.notes, config)
        if self.samples:
            raise SpecError(f"{self.target} is an object: --samples needs an aligned scene")
        return check_object(
            self.target,
            target,
            config,
            fixed_base=self.fixed_base,
            repair=self.repair,
            out=self.out,
        )

    def _check_scene(
        self, spec: "SceneSpec", notes: Sequence[str], config: "Config"
    ) -> CommandResult:
        """Check the scene of the target."""
        from ..measure import measured, scene_checks, with_displacement
        from ..run_folder import read_run, run_options

        options, run = config.refine, None
        if (self.target / "run.json").is_file():
            run = read_run(self.target)
            if self.config is None and not self.set:
                options = run_options(self.target, {}).refine
        measure = measured(spec, options)
        if run is not None:
            measure = with_displacement(measure, run["metrics"].get("displacement"))
        checks = scene_checks(measure, options)
        return {
            "target": str(self.target),
            **({"notes": list(notes)} if notes else {}),
            "passed": all(check.passed for check in checks),
            "checks": [check.to_json() for check in checks],
            **measure.model_dump(),
            **({"samples": self._samples(spec, options)} if self.samples else {}),
        }

    def _samples(self, scene: "SceneSpec", options: "RefineOptions") -> CommandResult:
        """Count in how many of the scenes that the photograph allows every object rests."""
        from ..environments.samples import sample

        if all(item.uncertainty is None for item in scene.objects):
            raise SpecError(f"{self.target} was not aligned: --samples needs an aligned scene")
        draws = sample(scene, self.samples, options=options, max_px=math.inf, redraws=0)
        failing = Counter(reason for reason in draws.reasons if reason)
        return {
            "draws": len(draws),
            "stand": int(draws.stands.sum()),
            "failing": dict(failing.most_common()),
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        if "movable" in result:
            return scene_check_lines(result)
        return object_check_lines(result)


@dataclass(frozen=True, kw_only=True)
class TemplateCommand(Command):
    """List the object templates, or write the program of one."""

    name: Positional[str | None] = None
    """Name of the template. Without a name, all templates are listed."""
    out: Path | None = None
    """Output file (.py) for the program; `neoworld check` builds the object."""
    seed: int | None = None
    """Seed for sampling all parameters from their ranges. Without it, parameters keep their
    defaults."""
    size: tuple[float, float, float] | None = None
    """Depth, width and height of the object [m], for example of a measured box. Each is clipped to
    the range of its parameter."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """Parameter as NAME=VALUE, such as --set drawers=4; repeatable."""

    def run(self) -> CommandResult:
        """List templates, or write a program."""
        from ..io.files import write_output
        from ..templates import template, templates

        if self.name is None:
            if self.out or self.size or self.set or self.seed is not None:
                raise SpecError("template: name a template; `neoworld template` lists them")
            return {"templates": {name: template.label for name, template in templates().items()}}
        chosen = template(self.name)
        if self.seed is not None and self.seed < 0:
            raise SpecError(f"--seed: got {self.seed}, valid is 0 or more")
        values = {} if self.seed is None else chosen.draw(self.seed)
        values |= {} if self.size is None else chosen.of_box(self.size)
        for setting in self.set:
            key, equals, value = setting.partition("=")
            if not equals:
                raise SpecError(f"--set takes NAME=VALUE, such as width=0.4, got {setting!r}")
            values[key] = _number(value)
        text = chosen.program(values)
        if self.out is not None:
            write_output(self.out, text, RunError)
        written = {} if self.out is None else {"program": str(self.out)}
        parameters = {
            name: {"value": values.get(name, p.default)}
            | ({"choices": list(p.choices)} if p.choices else {"range": [p.low, p.high]})
            | ({"unit": p.unit} if p.unit else {})
            for name, p in chosen.parameters.items()
        }
        return {
            "template": chosen.name,
            "label": chosen.label,
            **written,
            "parameters": parameters,
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        if "templates" in result:
            names = result["templates"]
            return [
                f"{count(names, 'template')}:",
                *wrapped(names),
                "use one: neoworld template NAME [--out x.py]; descriptions: -v, or --json",
            ]
        rows = [f"{result['template']}: {result['label']}"]
        rows += wrapped(_parameter(name, p) for name, p in result["parameters"].items())
        if "program" in result:
            rows += [f"program: {result['program']}", f"next: neoworld view {result['program']}"]
        else:
            rows.append(f"its program: neoworld template {result['template']} --out x.py")
        return rows


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _parameter(name: str, described: Mapping[str, Any]) -> str:
    value = described["value"]
    unit = f" {described['unit']}" if described.get("unit") else ""
    if "choices" in described:
        return f"{name} {value} ({', '.join(map(str, described['choices']))})"
    low, high = described["range"]
    return f"{name} {value:g} ({low:g} to {high:g}{unit})"


@dataclass(frozen=True, kw_only=True)
class ExportCommand(ConfiguredCommand):
    """Export a scene or an object to a format or for a simulator, and list what is lost."""

    target: Positional[Path]
    """A run folder, a scene.json, an object's folder, a program (.py), a URDF, MJCF or glTF
    file."""
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
        from ..export.object_of_mechanism import Imported
        from ..verify.read_target import PatchedProgram, read_target

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
        target = read_target(self.target, config.program)
        if isinstance(target, PatchedProgram) and not target.built.ok:
            errors = "; ".join(str(signal.message) for signal in target.built.signals)
            raise SpecError(f"{self.target} does not build: {errors}")
        # Objects are free, so an object that its file fixes to the world is a scene.
        fixed = target if isinstance(target, Imported) and target.fixed_base else None
        described = target.spec if fixed is None else fixed.scene
        files = write_formats(
            described, self.out, kinds, simulator=self.simulator, floor=self.floor
        )
        result: CommandResult = {
            "target": str(self.target),
            "folder": str(self.out),
            "files": files,
            "lost": {kind: losses(kind, described) for kind in kinds},
        }
        if target.notes:
            result["notes"] = list(target.notes)
        if mjx:
            result["collider_error_mm"] = round(1e3 * collider_error(described), 3)
        return result

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return export_lines(result)
