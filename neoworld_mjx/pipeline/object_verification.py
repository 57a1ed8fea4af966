"""Step 3 of a run for one object: run tests, ask models, write files and record the outcome."""

from collections.abc import Sequence

from ..checks.object_tests import run_object_tests
from ..compose.resting_pose import on_level, pose_without_scene
from ..program.attempt import SynthesisResult
from ..program.synthesise import Cutout, reprogram
from ..run_folder.open_folder import Moment
from ..spec import SceneTree, TreeNode
from ..verify.critic import Compute
from ..verify.films import films
from ..verify.patch import write_patch
from ..verify.verification import VerificationResult, verify_object
from .step_context import REPROGRAMMED_FILE, VERIFIED_FILE, StepContext, read_allowances, read_spec


class ObjectVerification:
    """Step 3 for one object of a run."""

    def __init__(
        self, context: StepContext, node: TreeNode, tree: SceneTree, crop: Cutout | None
    ) -> None:
        self._context, self._node, self._tree, self._crop = context, node, tree, crop
        self.name = f"verify/{node.name}"
        folder = context.run.path / "objects" / node.name
        self._folder = folder
        level = on_level(node, tree)
        self.inputs = {
            "spec": folder / "spec.json",
            "program": folder / "program.json",
            "options": context.config.verify,
            "node": node,
            "level": level,
            "surroundings": surroundings(node, tree),
        }
        self._object = read_spec(folder / "spec.json")
        self._tilt, self._fixed_base = pose_without_scene(node, self._object, level=level)

    async def result(self, compute: Compute) -> VerificationResult:
        """Test the object, and let models judge and edit it."""
        context, options = self._context, self._context.config.verify
        return await verify_object(
            self._object,
            options,
            fixed_base=self._fixed_base,
            tilt=self._tilt,
            allowed=read_allowances(self._folder / "program.json"),
            models=None if options.critic == "never" else context.models,
            surroundings=surroundings(self._node, self._tree),
            reprogram=None if self._crop is None or self._node.slab else self._reprogram,
            compute=compute,
        )

    async def _reprogram(self, findings: Sequence[str]) -> SynthesisResult:
        context = self._context
        assert self._crop is not None
        _, models = context.photo_and_models()
        text = (self._folder / "program.py").read_text(encoding="utf-8")
        options, camera = context.config.program, self._tree.camera
        return await reprogram(
            self._node, self._crop, text, findings, models, options, camera=camera
        )

    def write(self, result: VerificationResult, started: Moment) -> None:
        """Write the files of the step, and record its outcome."""
        run, options, node = self._context.run, self._context.config.verify, self._node
        with run.step(self.name, self.inputs, started=started) as out:
            assert out is not None
            object_folder = out / "objects" / node.name
            object_folder.mkdir(parents=True)
            (object_folder / "verify.json").write_text(result.to_json(), encoding="utf-8")
            program, rounds = object_folder / "program.py", self._folder / "program.json"
            if result.program is not None and result.program_json is not None:
                program = object_folder / REPROGRAMMED_FILE
                program.write_text(result.program, encoding="utf-8")
                rounds = program.with_suffix(".json")
                rounds.write_text(result.program_json, encoding="utf-8")
            if not result.patch.empty:
                write_patch(program, result.patch)
            if result.changed:
                text = result.applied(self._object).to_json()
                (object_folder / VERIFIED_FILE).write_text(text, encoding="utf-8")
            verdict = result.verdict
            if options.films == "always" or (
                options.films == "questionable" and verdict.questionable
            ):
                allowed = read_allowances(rounds)
                tests = run_object_tests(
                    result.applied(self._object),
                    options,
                    fixed_base=self._fixed_base,
                    tilt=self._tilt,
                    allowed=allowed,
                )
                for kind, film in films(tests).items():
                    (object_folder / f"{kind}.gif").write_bytes(film)
            self._record(result)

    def _record(self, result: VerificationResult) -> None:
        """Record the outcome of the step in run.json."""
        run, name = self._context.run, self._node.name
        if result.program is not None:
            reason = "; ".join(result.seen) or "the critic asked for it"
            run.note(self.name, f"{name} has a new program", reason)
        if not result.patch.empty:
            run.note(self.name, f"{name} was edited", "; ".join(result.changes))
        if result.waived:
            phrases = "; ".join(check.phrase() for check in result.waived)
            run.note(self.name, f"{name} is valid according to the critic", phrases)
        for critic, reason in result.lost_critics:
            run.fallback(self.name, f"{name} without the response to {critic}", reason)
        for reason in result.unmet:
            run.fallback(
                self.name,
                f"{name} keeps its program, although the critic asks for another one",
                reason,
            )
        failed = [check for check in result.verdict.checks if check.failed]
        if failed:
            checks = [check.phrase() if check.outcome == "FAIL" else check.hint for check in failed]
            hints = dict.fromkeys(check.hint for check in failed if check.outcome == "FAIL")
            remedy = f"; to repair it: {next(iter(hints))}" if hints else ""
            run.fallback(
                self.name,
                f"{name} fails {len(failed)} of its object tests and is used as it is",
                "; ".join(checks) + remedy,
            )


def surroundings(node: TreeNode, tree: SceneTree) -> str:
    """Describe what supports an object in its scene, as a sentence; "" if nothing does."""
    if node.parent is None:
        return ""
    parent = tree.node(node.parent)
    relation = {
        "on": "rests on",
        "in": "stands or lies in",
        "attached": "is fastened to",
        "leaning": "stands on, and leans against something next to,",
    }[node.relation]
    return f"In the scene it {relation} {parent.name} ({parent.label})."
