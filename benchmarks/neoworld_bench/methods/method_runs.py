"""Run methods on scenes or tasks from noisy initial scenes, in separate processes.

The rows of results are stored in files, so an interrupted run can continue.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from neoworld_mjx.config import ComposeOptions, RefineOptions
from neoworld_mjx.io.files import content_hash
from neoworld_mjx.places import HERE, Place, check_place, run_tasks
from neoworld_mjx.spec import SceneSpec

from ..fidelity.rendered_responses import exact_response
from ..noise.initial_scenes import (
    InitialScene,
    NoiseLevel,
    initial_scene,
    is_evaluation,
    noise_number,
)
from ..noise.parse_noise import NoiseLog
from ..row_files import RowFile, check_level
from ..rows import Row, log
from .named_methods import note_methods, options_json
from .scene_objects import ObjectRow


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
    rollouts: int
    fingerprint: str
    """Hash of the ground truth, the noise and the options."""

    @property
    def subject(self) -> str:
        """Name of the scene or task."""
        raise NotImplementedError

    @property
    def summary(self) -> str:
        """One line for the log."""
        raise NotImplementedError

    @property
    def key(self) -> tuple[str, int, int, str]:
        """Subject, initial scene, seed and method."""
        return self.subject, self.start, self.seed, self.method


R = TypeVar("R", bound=MethodRow)


@dataclass(frozen=True)
class RunSettings:
    """Settings of a run on which its rows depend."""

    seed: int
    """Seed of the noise and of the searches."""
    refine: RefineOptions
    """Options of the search and of the final check."""
    compose: ComposeOptions
    noise: NoiseLevel
    named: tuple[tuple[str, RefineOptions], ...] = ()
    """Options of the searches that a user named, by name."""

    def options_of(self, method: str) -> RefineOptions:
        """Return the options that a method is given, before it changes some of them."""
        return dict(self.named).get(method, self.refine)

    def of_method(self, method: str, fingerprint: str) -> str:
        """Return the fingerprint of a method's row, given the fingerprint of its subject."""
        options = dict(self.named).get(method)
        if options is None:
            return fingerprint
        return content_hash([fingerprint, options.model_dump(mode="json")])[:16]

    def fingerprint(self, *parts: Any) -> str:
        """Return the hash of JSON values, the noise and the options."""
        options = (o.model_dump(mode="json") for o in (self.refine, self.compose))
        return content_hash([self.noise, *parts, *options])[:16]


@dataclass(frozen=True)
class MethodJob:
    """Methods to run on one scene or task from one initial scene."""

    subject: str
    start: int
    methods: tuple[str, ...]
    settings: RunSettings
    threads: int
    fingerprint: str
    submission: Path | None = None
    """Folder of another method's scenes to score in place of running methods."""

    def composed(self, truth: SceneSpec, stream: str, errors: NoiseLog) -> SceneSpec:
        """Return only the scene of `initial`."""
        return self.initial(truth, stream, errors).scene

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

    def columns(self, method: str, errors: NoiseLog) -> dict[str, Any]:
        """Return the columns of `MethodRow`, except for `rollouts`."""
        return {
            "noise": self.settings.noise,
            "injected": ", ".join(errors.injected),
            "start": self.start,
            "seed": self.settings.seed,
            "evaluation": is_evaluation(self.start),
            "method": method,
            "fingerprint": self.settings.of_method(method, self.fingerprint),
        }


def run_jobs(
    work: Callable[[MethodJob], Iterable[tuple[R, Sequence[ObjectRow]]]],
    row_type: type[R],
    *,
    fingerprints: Mapping[str, str],
    starts: Mapping[str, Sequence[int]],
    methods: Sequence[str],
    settings: RunSettings,
    place: Place = HERE,
    file: Path | None = None,
    objects: Path | None = None,
    submission: Path | None = None,
) -> list[R]:
    """Run methods on scenes or tasks, except for rows that the file already contains.

    Args:
        work: module-level function that yields the rows of a job, each with the rows of its
            objects.
        row_type: type of the rows.
        fingerprints: fingerprint of each subject. Rows with another fingerprint are run again.
        starts: numbers of each subject's initial scenes.
        methods: names of the methods.
        settings: settings of the run.
        place: where the jobs run.
        file: Parquet file of the rows. If None, rows are not stored.
        objects: Parquet file of the rows of objects. If None, they are not stored.
        submission: folder of submitted scenes. They are scored again in each run.

    Returns:
        All requested rows, including rows from the file, sorted by key.

    Raises:
        RunError: a file cannot be read or written, a file has rows of another noise level, or a
            process died.
    """
    check_place(place)
    stored = RowFile(file, row_type, lambda row: row.key)
    check_level(stored, settings.noise)
    stored_objects = RowFile(objects, ObjectRow, lambda row: row.key)

    if file is not None and submission is None:
        used = {
            method: options_json(
                settings.options_of(method),
                noise=settings.noise,
                compose=settings.compose.model_dump(mode="json"),
            )
            for method in methods
        }
        note_methods(file.parent, used, {row.method for row in stored.rows})

    def is_current(row: R) -> bool:
        mark = fingerprints.get(row.subject)
        return mark is not None and settings.of_method(row.method, mark) == row.fingerprint

    done = set() if submission else {row.key for row in stored.rows if is_current(row)}
    jobs = []
    for subject, fingerprint in fingerprints.items():
        for start in starts[subject]:
            missing = tuple(m for m in methods if (subject, start, settings.seed, m) not in done)
            if missing:
                jobs.append(
                    MethodJob(
                        subject, start, missing, settings, place.threads, fingerprint, submission
                    )
                )
    # Sort by initial scene, so that an interrupted run has rows of all subjects.
    jobs.sort(key=lambda job: job.start)
    for row, object_rows in run_tasks(work, jobs, place):
        log.info(row.summary)
        # Store objects first, so that every stored row has the rows of its objects.
        stored_objects.put(object_rows, in_place_of=row.key)
        stored.put([row], in_place_of=row.key)
    requested = (
        row
        for row in stored.rows
        if is_current(row)
        and row.start in starts[row.subject]
        and row.seed == settings.seed
        and row.method in methods
    )
    return sorted(requested, key=lambda row: row.key)
