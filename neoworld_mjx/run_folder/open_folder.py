"""An open run folder: does each step once, in staging, and records what it read and wrote.

A step writes into a staging folder; when it has finished, its files are flushed, moved into place
and its record goes into run.json: a hash of what it read and one of each file it wrote. A process
killed at any moment leaves either the record, and then all files, or no record, and then the step
is done again. Only run.json, run.log and report.html carry times; every other file is a function of
the photograph, the options and the models' answers.
"""

import contextlib
import json
import logging
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ..config import Config
from ..errors import NeoWorldError, RunError, choices
from ..io.files import content_hash, write_atomic
from ..progress import report
from ..step_names import STEPS
from .run_json import read_run, running, strict_json
from .run_log import RUN_LOG, RunLog
from .staging import (
    STAGING,
    check_claimable,
    clear_unfinished,
    delete_files,
    disk_errors,
    lock_folder,
    move_in,
    set_aside,
)

_log = logging.getLogger(__name__)


class Moment(NamedTuple):
    """A moment of a run."""

    clock: float
    """`time.perf_counter()` [s]."""
    waited: float
    """Seconds until then in which models were asked and had not answered."""


class RunFolder:
    """An open, locked run folder. Use it in a `with` statement.

    Attributes:
        path: the folder.
        data: what run.json holds; `save` writes it.
        waited: returns the seconds so far in which models were asked and had not answered; who
            asks models sets it.
    """

    waited: Callable[[], float]

    def __init__(
        self,
        path: Path,
        config: Config,
        *,
        resume: bool = False,
        start: str | None = None,
        overwrite: bool = False,
        edited: str | None = None,
    ):
        """Create the folder, or go on in one.

        Args:
            path: the folder; it may exist if it is empty or a run.
            config: the options of the run.
            resume: keep finished steps of an earlier run whose inputs have not changed.
            start: delete what this step of an earlier run and all after it wrote, to do them
                again; the steps before it are kept as their files are, so edits by hand count.
            overwrite: delete what an earlier run wrote (and only that) and begin anew.
            edited: with `resume`: this step and those before it are not done again, whatever was
                edited in their files; those after it are done where what they read has changed.

        Raises:
            RunError: the path is a file, cannot be written, holds something else or a run that may
                not be touched, or is in use.
        """
        if start is not None and start not in STEPS:
            raise RunError(f"no such step: {choices(start, STEPS)}")
        self.path = Path(path)
        self.waited = lambda: 0.0
        self._visited: set[str] = set()
        self._kept = STEPS[: STEPS.index(start)] if start else ()
        if edited is not None:
            self._kept = STEPS[: STEPS.index(edited) + 1]
        if self.path.exists() and not self.path.is_dir():
            raise RunError(f"{path} is a file; name a folder that does not exist yet, or a run")
        with disk_errors(self.path, anywhere=True):
            check_claimable(self.path)
            if start is not None and not (self.path / "run.json").exists():
                raise RunError(f"{path} holds no run to begin from {start}; leave --from out")
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = lock_folder(self.path)
        try:
            with disk_errors(self.path):
                self._begin(config, resume or start is not None, start, overwrite)
                self._run_log = RunLog(self.path)
        except BaseException:
            self._lock.close()
            raise

    def __enter__(self) -> "RunFolder":
        """Return the folder itself."""
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Record how the run ended and unlock."""
        shutil.rmtree(self.path / STAGING, ignore_errors=True)
        try:
            if error is None:
                self.save()
                self._run_log.note(logging.INFO, f"run: {self.data['status']}")
                return
            interrupted = isinstance(error, KeyboardInterrupt)
            self.data["status"] = "interrupted" if interrupted else "failed"
            expected = isinstance(error, NeoWorldError)
            self.data["error"] = str(error) if expected else type(error).__name__
            self._run_log.note(logging.ERROR, f"run: {self.data['status']}: {self.data['error']}")
            with contextlib.suppress(RunError):  # The first error is the one to report.
                self.save()
        finally:
            self._run_log.close()
            self._lock.close()

    def finished(self, name: str, inputs: Mapping[str, object]) -> bool:
        """Tell whether `step` would keep this step as it is, without beginning it."""
        self._visited.add(name)
        return self._keeps(name, self._hashes(name, inputs))

    @contextlib.contextmanager
    def step(
        self, name: str, inputs: Mapping[str, object], *, begun: Moment | None = None
    ) -> Iterator[Path | None]:
        """Do a step of the run, unless it is finished: `with run.step(...) as out: if out: ...`.

        Args:
            name: one of `STEPS`, or such a name and a part, as in "program/cup".
            inputs: everything that decides what the step writes: paths stand for the contents of
                that file or folder, pydantic models and JSON values for themselves.
            begun: when its work began, by `now`, if before this call.

        Yields:
            An empty folder that stands for the run folder, to write the step's files into; None if
            the step is finished and its files are there. An error inside leaves no trace of it.

        Raises:
            RunError: an input is missing, or the disk is full or not writable.
        """
        if _step_of(name) not in STEPS:
            raise RunError(f"no such step: {choices(name, STEPS)}")
        hashes = self._hashes(name, inputs)
        self._visited.add(name)
        if self._keeps(name, hashes):
            yield None
            return
        begun = begun or self.now()
        old_outputs = self._forget(name)
        staged = self.path / STAGING / name.replace("/", ".")
        with disk_errors(self.path):
            shutil.rmtree(staged, ignore_errors=True)
            staged.mkdir(parents=True)
            report(f"{name}: begun", **_shown_step(name, name))
            yield staged
            outputs = move_in(staged, self.path)
            delete_files(self.path, set(old_outputs) - set(outputs))
        # A clock that was set back must not make a run.json that cannot be read again.
        seconds, waiting = (
            max(end - start, 0.0) for end, start in zip(self.now(), begun, strict=True)
        )
        self.data["steps"][name] = {
            "seconds": round(seconds, 3),
            "waiting_s": round(waiting, 3),
            "inputs": hashes,
            "outputs": outputs,
        }
        self.save()
        report(f"{name}: done in {seconds:.1f} s", **_shown_step(name, _step_of(name)))

    def fallback(self, step: str, what: str, why: str) -> None:
        """Record that a step had to do something lesser than requested."""
        if self._listed("fallbacks", step, what, why):
            _log.warning("%s: fell back to %s: %s", step, what, why)

    def note(self, step: str, what: str, why: str) -> None:
        """Record what a person should know of a step that did as requested, such as a far move."""
        if self._listed("notes", step, what, why):
            report(f"{step}: {what}: {why}")

    def _listed(self, kind: str, step: str, what: str, why: str) -> bool:
        """Add an entry to a list of run.json; return whether it is new."""
        entry = {"step": step, "what": what, "why": why}
        new = entry not in self.data[kind]
        if new:
            self.data[kind].append(entry)
        return new

    def record(self, section: str, **values: Any) -> None:
        """Put numbers, texts, lists and mappings into a section of run.json, such as "metrics"."""
        self.data.setdefault(section, {}).update(strict_json(values))

    def now(self) -> Moment:
        """Return this moment."""
        return Moment(time.perf_counter(), self.waited())

    def seconds(self) -> dict[str, float]:
        """Return the seconds each step took when it was last done; parts are added up."""
        return self._by_step("seconds")

    def waiting(self) -> dict[str, float]:
        """Return how many of a step's seconds passed while a model was asked; parts are added."""
        return self._by_step("waiting_s")

    def _by_step(self, key: str) -> dict[str, float]:
        total: dict[str, float] = {}
        for name, entry in self.data["steps"].items():
            step = _step_of(name)
            total[step] = round(total.get(step, 0.0) + entry.get(key, 0.0), 3)
        return total

    def finish(self, until: str | None = None) -> None:
        """Mark the run as finished, or as stopped after a step.

        A finished run deletes the files of steps that it did not visit, such as those of an object
        that is no longer in the tree.
        """
        if until is None:
            for name in sorted(set(self.data["steps"]) - self._visited):
                if _step_of(name) not in self._kept:
                    delete_files(self.path, self._forget(name))
        self.data["status"] = "finished" if until is None else f"stopped after {until}"
        self.save()

    def save(self) -> None:
        """Write run.json atomically."""
        with disk_errors(self.path):
            text = json.dumps(self.data, indent=1, allow_nan=False) + "\n"
            write_atomic(self.path / "run.json", text)

    def _begin(self, config: Config, resume: bool, start: str | None, overwrite: bool) -> None:
        self.data = {"steps": {}, "fallbacks": []}
        if (self.path / "run.json").exists():
            self.data = read_run(self.path)
            # A run that never finished a step has nothing to lose but the record of its cost.
            resume = resume or not (overwrite or self.data["steps"])
            if not (resume or overwrite):
                raise RunError(
                    f"{self.path} holds a run ({self.data['status']}): go on with --resume, do "
                    "part of it again with --from STEP, replace it with --overwrite, or name "
                    "another folder"
                )
        for name in [*self.data["steps"]]:
            if _step_of(name) not in self._kept if start is not None else overwrite and not resume:
                delete_files(self.path, self._forget(name))
        if not resume:
            for name in ("report.html", RUN_LOG):
                (self.path / name).unlink(missing_ok=True)
            self.data = {"steps": {}, "fallbacks": []}
        clear_unfinished(self.path)
        self.data = running(config, self.data)
        self.save()

    def _keeps(self, name: str, hashes: dict[str, str]) -> bool:
        """Tell whether a step is finished and unchanged; steps before `start` may be edited."""
        entry = self.data["steps"].get(name)
        if entry is None or not all((self.path / p).is_file() for p in entry["outputs"]):
            return False
        if _step_of(name) in self._kept:
            if entry["inputs"] != hashes:
                _log.warning("%s: kept although what it reads has changed", name)
            self.accept_edits(name)
            entry["inputs"] = hashes
        elif entry["inputs"] != hashes or self._edited(entry):
            return False
        report(f"{name}: kept as it is", **_shown_step(name, _step_of(name)))
        return True

    def accept_edits(self, name: str) -> None:
        """Record a step's edited files as its own, so that a later --resume takes them too."""
        entry = self.data["steps"][name]
        edited = self._edited(entry)
        if edited:
            entry["outputs"].update({path: content_hash(self.path / path) for path in edited})
            entry["edited"] = sorted({*entry.get("edited", []), *edited})

    def edited_by_hand(self, name: str) -> tuple[str, ...]:
        """Return the files of a finished step that were edited after it wrote them."""
        return tuple(self.data["steps"].get(name, {}).get("edited", ()))

    def _edited(self, entry: dict[str, Any]) -> list[str]:
        """Return a step's files whose contents are not those that it wrote."""
        return [
            name
            for name, written in entry["outputs"].items()
            if (self.path / name).is_file() and content_hash(self.path / name) != written
        ]

    def _forget(self, name: str) -> list[str]:
        """Drop a step's record and return its files; set those aside that were edited by hand."""
        for kind in ("fallbacks", "notes"):
            self.data[kind] = [entry for entry in self.data.get(kind, []) if entry["step"] != name]
        entry = self.data["steps"].pop(name, None)
        if entry is None:
            return []
        with disk_errors(self.path):
            for path in self._edited(entry):
                aside = set_aside(self.path, path)
                _log.warning("%s was changed after step %s wrote it: now %s", path, name, aside)
        self.save()
        return list(entry["outputs"])

    def _hashes(self, name: str, inputs: Mapping[str, object]) -> dict[str, str]:
        try:
            return {key: content_hash(value) for key, value in sorted(inputs.items())}
        except FileNotFoundError as error:
            raise RunError(
                f"step {name} needs {error.filename}, which is missing; "
                "do the step that makes it again with --from STEP"
            ) from None
        except OSError as error:
            raise RunError(f"step {name} cannot read {error.filename}: {error.strerror}") from None


def _step_of(name: str) -> str:
    return name.split("/", maxsplit=1)[0]


def _shown_step(name: str, shown: str) -> dict[str, str]:
    """Return the fact of the status line; pictures are drawn beside other work, and are not it."""
    return {} if name.endswith("/picture") else {"step": shown}
