"""Policies trained in reconstructions, and run in the ground truth.

A flying gripper learns the task in a reconstruction, from the start of the reference plan there, or
a robot on a mount that is proposed there. It is then run in the ground truth, whose objects it
observes as in the reconstruction: their poses and joints, and the point of contact and the goal as
the reconstruction has them. Success is judged
as that of plans: the last controls stay for two seconds, and the predicate of the ground truth must
hold in every state of the last. Physical quantities of the ground truth are drawn from the priors
of `nw.sample`, about their true values; its poses and sizes are the true ones.
"""

import copy
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.environments.policy import Policy, Setting, read_policy
from neoworld_mjx.environments.predicates import Predicate
from neoworld_mjx.environments.randomization import Variants, variants_of
from neoworld_mjx.environments.samples import SceneSamples, sample
from neoworld_mjx.environments.task import SceneTask, Task
from neoworld_mjx.environments.training import (
    POLICY,
    Training,
    default_options,
    snapshot_name,
    train_task,
)
from neoworld_mjx.environments.trials import EVALUATION_SEED, episodes, last
from neoworld_mjx.spec import SceneSpec

from ..methods.method_runs import MethodJob, MethodRow
from ..noise.parse_noise import NoiseLog
from ..rows import Row
from .catalogue import all_tasks, find_task
from .execution import START_DEPTH_M, judge
from .plan_reliability import truth_samples
from .policy_tasks import Effector, policy_task, with_start_noise
from .success_runs import common_offset, described, planned_there
from .task import ManipulationTask, TaskKind
from .task_scenes import photographed_task
from .world import World

KINDS: tuple[TaskKind, ...] = ("opening", "closing", "pushing", "placement")
"""Kinds of tasks that policies are trained for."""
HORIZON, ROBOT_HORIZON = 125, 200
"""Actions of an episode of a flying gripper, and of a robot, which is slower."""
END = ("qpos", "qvel", "act", "ctrl")
"""Fields of the state at the end of an episode, from which the judge continues."""
SNAPSHOTS = (0.1, 0.3, 1.0)
"""Shares of a training after which its policy is run."""


def drawn_tasks(each: int, seed: int = 0) -> list[str]:
    """Return the first `each` tasks of each of KINDS in a shuffled order."""
    names = []
    for kind in KINDS:
        own = [task.name for task in all_tasks() if task.kind == kind]
        order = np.random.default_rng(seed).permutation(len(own))
        names += [own[k] for k in order[:each]]
    return names


class PolicyResult(Row):
    """One policy, or plan, and its successes."""

    share: float
    """Share of the training."""
    steps: int
    """Control steps of the training."""
    predicted: int
    """Successes in draws of its own scene that training did not see."""
    predicted_n: int
    on_truth: int
    """Successes in the ground truth, without the offset that all objects share."""
    unaligned: int
    """Successes in the ground truth as it is."""
    truth_n: int


class PolicyRow(MethodRow):
    """Results of one training, or of the plan, on one task from one initial scene."""

    task: str
    kind: str
    reason: str = ""
    """Reason why there is no policy; empty if there is."""
    results: tuple[PolicyResult, ...] = ()
    """By the share of the training; the last is the trained policy."""
    shift_m: float = 0.0
    """Length of the offset that all objects share."""

    @property
    def subject(self) -> str:
        """Name of the task."""
        return self.task

    @property
    def summary(self) -> str:
        """Line of the log."""
        end = self.results[-1] if self.results else None
        done = self.reason or (
            f"truth {end.on_truth} of {end.truth_n}, as it is {end.unaligned}, own scene "
            f"{end.predicted} of {end.predicted_n}"
            if end
            else "no result"
        )
        return f"{self.task} start {self.start} {self.method}: {done}"


@dataclass(frozen=True)
class PolicyTraining:
    """Options of all trainings of a run."""

    training: Training
    worlds: int | None
    samples: int
    """Draws in which policies are run."""
    setting: Setting
    folder: Path
    """Folder of the policies."""
    robot: str | None = None
    """Robot instead of a flying gripper."""
    method: str = "ours"
    """Method that makes the reconstructions."""
    reconstructions: dict[tuple[str, int, str], tuple[SceneSpec, NoiseLog]] = field(
        default_factory=dict
    )
    """Reconstructions of this process, by task, start and evidence."""


def policy_rows(o: PolicyTraining, job: MethodJob) -> Iterator[PolicyRow]:
    """Train and run the policies of a job, and yield a row for each; exceptions are failures."""
    task = find_task(job.subject)
    for method in job.methods:
        scene, errors, fields = task.scene, NoiseLog(), dict[str, Any]()
        try:
            if method != "truth":
                scene, errors = _reconstruction(o, job, task)
            fields["shift_m"] = float(np.linalg.norm(common_offset(task, scene)))
            if method == "plan":
                fields["results"] = (_plan_result(task, scene),)
            else:
                evidence = "photo" if job.evidence == "none" else job.evidence
                name = [task.name, str(job.start), method]
                if method != "truth":
                    name += [evidence, *[o.method] * (o.method != "ours")]
                folder = o.folder / "-".join([*name, *([Path(o.robot).stem] if o.robot else [])])
                fields["results"] = _trained(o, task, method, scene, folder)
        except Exception as error:  # An error of one task must not end the run of all others.
            fields["reason"] = described(error)
        columns = job.columns(method, errors)
        yield PolicyRow(**columns, task=task.name, kind=task.kind, rollouts=0, **fields)


def _reconstruction(
    o: PolicyTraining, job: MethodJob, task: ManipulationTask
) -> tuple[SceneSpec, NoiseLog]:
    """Return the reconstruction of a job and the errors of its initial scene."""
    key = task.name, job.start, job.evidence
    if key not in o.reconstructions:
        photo, errors = photographed_task(task.scene), NoiseLog()
        initial = job.initial(photo.scene, f"task/{task.name}", errors)
        [(_, result)] = job.outcomes((o.method,), initial, photo.scene)
        o.reconstructions[key] = photo.back(result.scene), errors
    return o.reconstructions[key]


def _plan_result(task: ManipulationTask, scene: SceneSpec) -> PolicyResult:
    there = planned_there(task, scene)
    return PolicyResult(
        share=1.0, steps=0, predicted=int(there.in_scene.success), predicted_n=1,
        on_truth=int(there.on_truth.success), unaligned=int(there.unaligned.success), truth_n=1,
    )  # fmt: skip


def _trained(
    o: PolicyTraining, task: ManipulationTask, method: str, inside: SceneSpec, folder: Path
) -> tuple[PolicyResult, ...]:
    """Train in a reconstruction, or in the ground truth, and run all snapshots."""
    plan, goal = task.plan_in(inside), task.predicate_in(inside)
    own = policy_task(task, inside, plan, goal)
    effector = Effector.of(own, plan, o.robot)
    learned, drawn = effector.on(own), None
    if method != "mean":
        draws = sample(inside, o.training.samples, seed=o.training.seed, sizes=False)
        drawn = with_start_noise(learned, variants_of(learned.controlled, draws), o.training.seed)
    options = default_options(o.training.engine or "native")
    if o.worlds is not None:
        options = replace(options, worlds=o.worlds)
    train_task(
        learned, o.setting, folder, variants=drawn,
        script=effector.script(learned, plan, o.setting.control_s), training=o.training,
        options=options, resume=(folder / POLICY).exists(),
    )  # fmt: skip
    seed = EVALUATION_SEED + o.training.seed
    before = _Arena(o, own, effector, sample(inside, o.samples, seed=seed, sizes=False), goal)
    truth = truth_samples(task.name, o.samples, seed)
    there = Task(own.instruction, task.scene, own.goal, own.point)
    shift = -common_offset(task, inside)
    aligned = _Arena(o, there, effector.moved(shift), truth, task.predicate)
    same = not np.any(shift)
    as_it_is = aligned if same else _Arena(o, there, effector, truth, task.predicate)
    results = []
    for share in SNAPSHOTS:
        policy = read_policy(folder / snapshot_name(share))
        predicted, on_truth = before.successes(policy), aligned.successes(policy)
        unaligned = on_truth if same else as_it_is.successes(policy)
        results.append(
            PolicyResult(
                share=share,
                steps=policy.about.steps,
                predicted=int(predicted.sum()),
                predicted_n=len(predicted),
                on_truth=int(on_truth.sum()),
                unaligned=int(unaligned.sum()),
                truth_n=len(on_truth),
            )
        )
    return tuple(results)


class _Arena:
    """Draws of a scene in which policies are run and judged."""

    def __init__(
        self,
        o: PolicyTraining,
        task: Task,
        effector: Effector,
        samples: SceneSamples,
        goal: Predicate,
    ) -> None:
        self._task = effector.on(task)
        self._variants = variants_of(self._task.controlled, samples)
        self._states = episodes(self._task, o.setting, self._variants)
        self._goal = goal

    def successes(self, policy: Policy) -> NDArray:
        """Return which draws a policy succeeds in."""
        ends = last(self._states(policy))
        end = [np.asarray(getattr(ends.data, name)) for name in END]
        lost = np.asarray(ends.done) > 0
        with ThreadPoolExecutor() as threads:
            judged = lambda k: (
                not lost[k]
                and _succeeds(self._task, self._variants, k, [v[k] for v in end], self._goal)
            )
            return np.array(list(threads.map(judged, range(len(lost)))))


def _succeeds(
    task: SceneTask,
    variants: Variants,
    k: int,
    end: Sequence[NDArray],
    goal: Predicate,
) -> bool:
    """Return whether the goal holds after an episode; no gripper may start inside an object."""
    model = copy.copy(task.controlled.model)
    for name, values in variants.fields.items():
        getattr(model, name)[:] = values[k]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    world = World(task.task.scene, None, model=model)
    data = world.data
    data.qpos[:], data.ctrl[:] = variants.qpos[k], task.controlled.initial_ctrl
    mujoco.mj_forward(model, data)
    if world.depth_of_gripper()[0] > START_DEPTH_M:
        return False
    for name, values in zip(END, end, strict=True):
        getattr(data, name)[:] = values
    mujoco.mj_forward(model, data)
    return judge(world, goal).success
