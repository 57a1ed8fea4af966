"""Runs of methods on scenes or tasks from noisy initial scenes, in separate processes."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import UInt8
from pydantic import ValidationError

from neoworld_mjx.config import ComposeOptions, Config, RefineOptions, merged, read_yaml
from neoworld_mjx.errors import ConfigError, RunError
from neoworld_mjx.io.files import content_hash
from neoworld_mjx.io.text_files import validation_message
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.places import HERE, Place, check_place, run_tasks
from neoworld_mjx.refinement.optimizer import optimizer_factory
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
from ..rows import Row, RowStore, log
from .scene_methods import METHODS, MethodResult, outcomes_of


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
        photo: Callable[[], UInt8[np.ndarray, "row column 3"]],
        *,
        warm: bool = True,
    ) -> Iterator[tuple[str, MethodResult]]:
        """Run methods from the initial scene, and yield each name with its result.

        Args:
            methods: names of the methods.
            initial: the initial scene with its programs.
            photo: function that returns the photograph.
            warm: True to compile before the times are measured.
        """
        s = self.settings
        return outcomes_of(
            methods,
            initial,
            s.refine,
            NativeEngine(threads=self.threads),
            photo,
            align=s.compose.align,
            seed=s.seed,
            warm=warm,
            named=dict(s.named),
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
            "fingerprint": self.settings.of_method(method, self.fingerprint),
        }


def read_methods(
    names: Sequence[str], config: Config
) -> tuple[tuple[str, ...], tuple[tuple[str, RefineOptions], ...]]:
    """Return the methods of a command line, and the options of those that it names itself.

    Args:
        names: methods of METHODS, and NAME=FILE for the search with the options of a YAML file on
            top of the configuration, such as `mine=mine.yaml` with another `refine.optimizer`.
        config: the configuration.

    Raises:
        ConfigError: a name is taken, or a file or an option is invalid.
    """
    methods: list[str] = []
    options: dict[str, RefineOptions] = {}
    for text in names:
        name, equals, file = text.partition("=")
        if equals:
            if name in METHODS or name in options or not name.replace("_", "").isalnum():
                raise ConfigError(f"--method {text}: take another name, of letters, digits and _")
            options[name] = _refine_options(Path(file), config)
            # Before anything runs: the optimizer may need a package that is not installed.
            optimizer_factory(options[name].optimizer)
        methods.append(name)
    return tuple(dict.fromkeys(methods)), tuple(options.items())


def _refine_options(file: Path, config: Config) -> RefineOptions:
    changes = read_yaml(file, "options of a method")
    if not isinstance(changes, dict) or set(changes) != {"refine"}:
        raise ConfigError(f"{file}: options of a method are those under refine, and no others")
    try:
        return Config.model_validate(merged(config.model_dump(mode="json"), changes)).refine
    except ValidationError as error:
        raise ConfigError(f"{file}: {validation_message(error, Config)}") from None


def run_jobs(
    work: Callable[[MethodJob], Iterable[R]],
    row_type: type[R],
    *,
    fingerprints: Mapping[str, str],
    starts: Mapping[str, Sequence[int]],
    methods: Sequence[str],
    settings: RunSettings,
    place: Place = HERE,
    store: RowStore | None = None,
    submission: Path | None = None,
) -> list[R]:
    """Run methods on scenes or tasks, except for rows that are already stored.

    Args:
        work: module-level function that yields the rows of a job.
        row_type: type of the rows.
        fingerprints: fingerprint of each subject.
        starts: numbers of each subject's initial scenes.
        methods: names of the methods.
        settings: settings of the run.
        place: where the jobs run.
        store: stored rows, to which new ones are added. If None, rows are not stored.
        submission: folder of submitted scenes. They are scored again in each run.

    Returns:
        All requested rows, including stored ones, sorted by key.

    Raises:
        RunError: a file cannot be written, a requested method has rows of other options or scenes,
            there are rows of another noise level, or a process died.
    """
    check_place(place)
    store = store or RowStore(None)
    rows = {row.key: row for row in store.of(row_type)}
    _check_rows(rows.values(), store, methods, settings, {} if submission else fingerprints)
    jobs = []
    for subject, fingerprint in fingerprints.items():
        for start in starts[subject]:
            known = set() if submission else set(rows)
            missing = tuple(m for m in methods if (subject, start, settings.seed, m) not in known)
            if missing:
                jobs.append(
                    MethodJob(
                        subject, start, missing, settings, place.threads, fingerprint, submission
                    )
                )
    # Sort by initial scene, so that an interrupted run has rows of all subjects.
    jobs.sort(key=lambda job: job.start)
    for row in run_tasks(work, jobs, place):
        log.info(row.summary)
        store.put(f"{row_type.__name__} {'/'.join(map(str, row.key))}", [row])
        rows[row.key] = row
    requested = (
        row
        for row in rows.values()
        if row.subject in starts
        and row.start in starts[row.subject]
        and row.seed == settings.seed
        and row.method in methods
    )
    return sorted(requested, key=lambda row: row.key)


def _check_rows(
    rows: Iterable[MethodRow],
    store: RowStore,
    methods: Sequence[str],
    settings: RunSettings,
    fingerprints: Mapping[str, str],
) -> None:
    """Check that stored rows have the noise level and the options of this run."""
    for row in rows:
        if row.noise != settings.noise:
            raise RunError(
                f"{store.file} has rows of --noise {row.noise}: name another folder for --noise "
                f"{settings.noise}"
            )
        mark = fingerprints.get(row.subject)
        if (
            mark is not None
            and row.method in methods
            and row.fingerprint != settings.of_method(row.method, mark)
        ):
            raise RunError(
                f"{store.file} has rows of {row.method} on {row.subject} with other options or "
                "another scene: name another folder, or this run's search with --method NAME=FILE"
            )
