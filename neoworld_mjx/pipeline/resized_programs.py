"""Programs whose dimensions Step 4 changes: how a run builds and checks them, and their files.

The changed program and the object that it builds, with the patch of Step 3, replace program.py and
spec.json of the object.
"""

from collections.abc import Mapping, Set
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from ..checks.object_tests import run_object_tests
from ..checks.verdict import Verdict
from ..compose.resting_pose import on_level, pose_without_scene
from ..config import Config, ProgramOptions, VerifyOptions
from ..errors import SpecError
from ..io import read_object
from ..program.freed_dimensions import EditablePrograms, FreedScene
from ..program.sandbox import build
from ..program.sandbox import run as run_program
from ..run_folder import RunFolder
from ..spec import ObjectSpec, SceneTree, TreeNode
from ..verify.patch import Patch, apply, read_patch
from .step_context import PROGRAM, SPEC, object_file


def editable_programs(
    run: RunFolder, tree: SceneTree, objects: Mapping[str, ObjectSpec], config: Config
) -> EditablePrograms:
    """Return the programs of a run's objects, of which `place` may change dimensions.

    Args:
        run: the run folder.
        tree: the scene tree.
        objects: the built objects, by name.
        config: options of the run.
    """
    sources = {node.name: _source(run, node, tree, config) for node in tree.nodes}
    return EditablePrograms(
        {name: source.text for name, source in sources.items() if source.builds(objects[name])},
        lambda name, text: sources[name].object_of(text),
        lambda name, text: sources[name].fault(text),
    )


def program_files(run: RunFolder, tree: SceneTree) -> dict[str, Path]:
    """Return the files on which the changed programs of a run depend, by the name of the input."""
    files = {}
    for node in tree.nodes:
        if not node.environment:
            for file in (PROGRAM, "verify.json"):
                path = run.before("compose", object_file(node.name, file))
                if path.is_file():
                    files[f"{node.name}/{file}"] = path
    return files


def write_resized(freed: FreedScene, out: Path) -> None:
    """Write the changed programs and the objects that they build into a step's staging folder."""
    for name, text in freed.texts.items():
        folder = out / "objects" / name
        folder.mkdir(parents=True)
        (folder / PROGRAM).write_text(text, encoding="utf-8")
        (folder / SPEC).write_text(freed.specs[name].to_json(), encoding="utf-8")


@dataclass(frozen=True)
class _Source:
    """The program of one object of a run, and the tests that a changed program must pass."""

    text: str
    """Text of the program; empty if there is no program."""
    patch: Patch
    node: TreeNode
    level: bool
    """True if the object is on level ground in its scene."""
    options: ProgramOptions
    tests: VerifyOptions
    known_failures: Set[str]
    """Checks that the object failed before."""

    def builds(self, spec: ObjectSpec) -> bool:
        """Return True if there is a program of a movable object, and it builds this object."""
        movable = bool(self.text) and not self.node.environment
        return movable and self.object_of(self.text) == spec

    def object_of(self, text: str) -> ObjectSpec | str:
        """Return the patched object that a program builds, or the reason why it builds none."""
        result = run_program(text, self.options)
        return result.errors if result.spec is None else self._patched(result.spec)

    def fault(self, text: str) -> str:
        """Return why a changed program is not valid; empty if its object fails no new check."""
        result = build(text, self.options)
        if result.spec is None or not result.ok:
            return result.errors
        spec = self._patched(result.spec)
        tilt, fixed = pose_without_scene(self.node, spec, level=self.level)
        tests = run_object_tests(
            spec, self.tests, fixed_base=fixed, tilt=tilt, allowed=result.allowances
        )
        new = _failed(tests.verdict) - self.known_failures
        return f"it fails {', '.join(sorted(new))}" if new else ""

    def _patched(self, spec: ObjectSpec) -> ObjectSpec:
        return spec if self.patch.empty else apply(self.patch, spec)[0]


def _source(run: RunFolder, node: TreeNode, tree: SceneTree, config: Config) -> _Source:
    path = run.before("compose", object_file(node.name, PROGRAM))
    folder = run.path / "objects" / node.name
    verdict, patch = folder / "verify.json", read_patch(folder / PROGRAM)
    return _Source(
        path.read_text(encoding="utf-8") if path.is_file() else "",
        patch or Patch(),
        node,
        on_level(node, tree),
        config.program.model_copy(update={"language": "sdk"}),
        config.verify,
        _failed(_read_verdict(verdict)) if verdict.is_file() else frozenset(),
    )


def _read_verdict(path: Path) -> Verdict:
    data = read_object(path, SpecError)
    try:
        return Verdict.model_validate({key: data[key] for key in Verdict.model_fields})
    except (KeyError, ValidationError) as error:
        raise SpecError(f"{path} contains no verdict: {str(error).splitlines()[0]}") from None


def _failed(verdict: Verdict) -> set[str]:
    return {
        " ".join(filter(None, (check.scenario, check.name, check.part, check.joint)))
        for check in verdict.checks
        if check.failed
    }
