"""Runs of methods on scenes or tasks from noisy initial scenes, in separate processes."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from neoworld_mjx.config import ComposeOptions, Config, RefineOptions
from neoworld_mjx.machines import HERE, Machines, check_machines, run_tasks
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.spec import SceneSpec

from ..fidelity.rendered_responses import exact_response
from ..fidelity.rendered_scenes import photograph
from ..noise.initial_scenes import (
    InitialScene,
    NoiseLevel,
    initial_scene,
    is_evaluation,
    noise_number,
)
from ..noise.known_evidence import kinds_of, known_evidence
from ..noise.parse_noise import NoiseLog
from ..rows import Row, RowStore, log
from .scene_methods import MethodResult, outcomes_of


class MethodRow(Row):
    """Columns that the results of methods on scenes and on tasks have in common."""

    noise: str
    """Noise level of the initial scene."""
    injected: str
    """Kinds of errors in the initial scene other than errors of its numbers, comma-separated; see
    `parse_noise`."""
    start: int
    """Number of the initial scene."""
    seed: int
    evaluation: bool
    """True if the initial scene is in the evaluation half."""
    method: str
    evidence: str
    """Kinds of evidence in addition to the photograph, joined by "+"; "none" for none."""
    rollouts: int

    @property
    def subject(self) -> str:
        """Name of the scene or task."""
        raise NotImplementedError

    @property
    def summary(self) -> str:
        """One line for the log."""
        raise NotImplementedError

    @property
    def label(self) -> str:
        """Method and evidence."""
        return self.method if self.evidence == "none" else f"{self.method} with {self.evidence}"

    @property
    def key(self) -> tuple[str, int, int, str, str]:
        """Subject, initial scene, seed, evidence and method."""
        return self.subject, self.start, self.seed, self.evidence, self.method


R = TypeVar("R", bound=MethodRow)


def by_method(rows: Sequence[R]) -> Iterator[tuple[str, list[R]]]:
    """Yield each method, with its evidence, and its rows."""
    for label in dict.fromkeys(row.label for row in rows):
        yield label, [row for row in rows if row.label == label]


@dataclass(frozen=True)
class RunSettings:
    """Settings of a run."""

    seed: int
    """Seed of the noise and of the searches."""
    refine: RefineOptions
    """Options of the search and of the final check."""
    compose: ComposeOptions
    noise: NoiseLevel
    evidence: tuple[str, ...] = ("none",)
    """Evidence in addition to the photograph: kinds joined by "+"; methods run with each."""
    samples: int = 0
    """Number of draws about each result, in which plans of tasks are executed."""


def run_settings(options: Any, config: Config, evidence: Sequence[str]) -> RunSettings:
    """Return the settings of a run from the options of a suite and the configuration.

    Raises:
        SpecError: a kind of evidence is unknown, or two exclude each other.
    """
    for words in evidence:
        kinds_of(words)
    given = tuple(dict.fromkeys(evidence))
    return RunSettings(options.seed, config.refine, config.compose, options.noise, given)


@dataclass(frozen=True)
class MethodJob:
    """Methods to run on one scene or task from one initial scene."""

    subject: str
    start: int
    methods: tuple[str, ...]
    settings: RunSettings
    threads: int
    evidence: str = "none"
    """Evidence in addition to the photograph: kinds joined by "+", or none."""

    def initial(self, truth: SceneSpec, stream: str, errors: NoiseLog) -> InitialScene:
        """Add noise to the exact response for the ground truth, and compose the initial scene.

        Args:
            truth: ground-truth scene with a camera.
            stream: name from which the seed of the noise is derived.
            errors: log to which the injected errors are added.
        """
        s = self.settings
        number = noise_number(stream, s.seed, self.start)
        response = exact_response(truth)
        return initial_scene(truth, response, number, s.compose, noise=s.noise, log=errors)

    def outcomes(
        self,
        methods: Sequence[str],
        initial: InitialScene,
        truth: SceneSpec,
    ) -> Iterator[tuple[str, MethodResult]]:
        """Run methods from the initial scene, and yield each name with its result.

        Args:
            methods: names of the methods.
            initial: the initial scene with its programs.
            truth: the ground truth, which is photographed, with the evidence about it.
        """
        s = self.settings
        number = noise_number(f"evidence/{self.subject}", s.seed, self.start)
        return outcomes_of(
            methods,
            initial,
            s.refine,
            NativeEngine(threads=self.threads),
            lambda: known_evidence(kinds_of(self.evidence), truth, photograph(truth), number),
            align=s.compose.align,
            seed=s.seed,
        )

    def columns(self, method: str, errors: NoiseLog) -> dict[str, Any]:
        """Return the columns of `MethodRow`, except for `rollouts`."""
        return {
            "noise": self.settings.noise,
            "injected": ", ".join(errors.injected),
            "start": self.start,
            "seed": self.settings.seed,
            "evaluation": is_evaluation(self.start),
            "method": method,
            "evidence": self.evidence,
        }


def run_jobs(
    work: Callable[[MethodJob], Iterable[R]],
    row_type: type[R],
    *,
    starts: Mapping[str, Sequence[int]],
    methods: Sequence[str],
    settings: RunSettings,
    machines: Machines = HERE,
    store: RowStore | None = None,
    in_turn: bool = False,
) -> list[R]:
    """Run methods on scenes or tasks, except for rows that are already stored.

    Args:
        work: module-level function that yields the rows of a job.
        row_type: type of the rows.
        starts: numbers of each subject's initial scenes.
        methods: names of the methods.
        settings: settings of the run.
        machines: where the jobs run.
        store: rows of an interrupted run, to which new ones are added; None keeps none.
        in_turn: run each method on all subjects before the next method, in the order of `methods`.

    Returns:
        All rows, including stored ones, sorted by subject, start, seed, evidence and method; the
        last two as in the arguments.

    Raises:
        RunError: a file cannot be written, or a process died.
    """
    check_machines(machines)
    store = store or RowStore(None)
    rows = {row.key: row for row in store.of(row_type)}
    jobs = []
    for subject, numbers in starts.items():
        for start, given in itertools.product(numbers, settings.evidence):
            of = (subject, start, settings.seed, given)
            missing = tuple(method for method in methods if (*of, method) not in rows)
            for part in [(method,) for method in missing] if in_turn else [missing]:
                if part:
                    jobs.append(MethodJob(subject, start, part, settings, machines.threads, given))
    # Sort by initial scene, so that an interrupted run has rows of all subjects.
    jobs.sort(key=lambda job: (in_turn * methods.index(job.methods[0]), job.start))
    for row in run_tasks(work, jobs, machines):
        log.info(row.summary)
        store.put(f"{row_type.__name__} {'/'.join(map(str, row.key))}", [row])
        rows[row.key] = row

    def position(row: R) -> tuple[Any, ...]:
        given, method = settings.evidence.index(row.evidence), methods.index(row.method)
        return row.subject, row.start, row.seed, given, method

    return sorted(rows.values(), key=position)
