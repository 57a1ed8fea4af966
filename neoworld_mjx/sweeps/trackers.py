"""Experiment trackers, which receive every iteration of the runs of a sweep or an ablation.

A tracker is a function `on_iteration(run, summary)`. There are trackers for TensorBoard, W&B and
MLflow, whose packages are imported only if a user names them.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import ConfigError, EngineError, RunError, choices
from .plan import plain_value


class TrackedRun(NamedTuple):
    """Identity of a run."""

    scene: str
    point: str
    seed: int
    values: Mapping[str, Any]
    """Values that distinguish the point, by the path of the option."""

    @property
    def title(self) -> str:
        """Scene, point and seed as a single string."""
        return f"{self.scene}, {self.point}, seed {self.seed}"


OnIteration = Callable[[TrackedRun, Mapping[str, Any]], None]
"""Function that receives each iteration of a run, in order.

The second argument has the columns of histories.parquet: "iteration", "rollouts", "best", "merit",
"mean", "valid" and the terms. Unknown values are None.
"""


def open_tracker(text: str) -> AbstractContextManager[OnIteration]:
    """Return the tracker that KIND:PLACE names, for use in a `with` statement.

    Args:
        text: tensorboard:DIR, wandb:PROJECT or mlflow:URI.

    Raises:
        ConfigError: the kind does not exist, or the place is missing.
        EngineError: the package of the tracker is not installed.
    """
    kind, _, place = text.partition(":")
    if kind not in TRACKERS:
        raise ConfigError(f"--track: {choices(kind, TRACKERS)}")
    if not place:
        raise ConfigError(f"--track takes KIND:PLACE, such as tensorboard:logs, got {text!r}")
    package, function = TRACKERS[kind]
    try:
        module = import_module(package)
    except ImportError:
        raise EngineError(
            f"--track {kind} needs {package}: uv sync --inexact --extra {kind}"
        ) from None
    return function(module, place)


def _numbers(summary: Mapping[str, Any]) -> dict[str, float]:
    return {
        name: float(value)
        for name, value in summary.items()
        if name != "iteration" and value is not None
    }


@contextmanager
def _tensorboard(module: Any, place: str) -> Iterator[OnIteration]:
    """Write event files with tensorboardX, in one folder for each run."""
    writers: dict[str, Any] = {}

    def on_iteration(run: TrackedRun, summary: Mapping[str, Any]) -> None:
        if run.title not in writers:
            folder = Path(place) / run.title.replace("/", "_")
            try:
                writers[run.title] = module.SummaryWriter(str(folder))
            except OSError as error:
                raise RunError(f"--track: cannot write {folder}: {error.strerror}") from None
        for name, value in _numbers(summary).items():
            writers[run.title].add_scalar(name, value, summary["iteration"])
        writers[run.title].flush()

    try:
        yield on_iteration
    finally:
        for writer in writers.values():
            writer.close()


@contextmanager
def _wandb(module: Any, place: str) -> Iterator[OnIteration]:
    """Log into a project of W&B; WANDB_MODE=offline keeps the runs in ./wandb."""
    runs: dict[str, Any] = {}

    def on_iteration(run: TrackedRun, summary: Mapping[str, Any]) -> None:
        if run.title not in runs:
            for name in list(runs):  # The previous run is complete.
                runs.pop(name).finish()
            config = {name: plain_value(value) for name, value in run.values.items()}
            runs[run.title] = module.init(
                project=place, name=run.title, group=run.point, reinit="create_new",
                config=config | {"scene": run.scene, "seed": run.seed},
            )  # fmt: skip
        runs[run.title].log(_numbers(summary), step=summary["iteration"])

    try:
        yield on_iteration
    finally:
        for run in runs.values():
            run.finish()


@contextmanager
def _mlflow(module: Any, place: str) -> Iterator[OnIteration]:
    """Log into the experiment `neoworld` of a tracking server or store."""
    client = module.MlflowClient(tracking_uri=place)
    found = client.get_experiment_by_name("neoworld")
    experiment = client.create_experiment("neoworld") if found is None else found.experiment_id
    runs: dict[str, str] = {}

    def on_iteration(run: TrackedRun, summary: Mapping[str, Any]) -> None:
        if run.title not in runs:
            runs[run.title] = client.create_run(experiment, run_name=run.title).info.run_id
            names = {"scene": run.scene, "point": run.point, "seed": run.seed, **run.values}
            for name, value in names.items():
                client.log_param(runs[run.title], name, plain_value(value))
        for name, value in _numbers(summary).items():
            client.log_metric(runs[run.title], name, value, step=summary["iteration"])

    try:
        yield on_iteration
    finally:
        for number in runs.values():
            client.set_terminated(number)


TRACKERS = {
    "tensorboard": ("tensorboardX", _tensorboard),
    "wandb": ("wandb", _wandb),
    "mlflow": ("mlflow", _mlflow),
}
"""Package and function of each kind of tracker."""
