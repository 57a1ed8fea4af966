"""An open run folder: runs each step once and records hashes of its inputs and outputs.

A step writes into a staging folder. When it finishes, its files are flushed and moved into place,
and its record is added to run.json: a hash of every input and of every file it wrote. A process
killed at any moment leaves either the record and all files, or no record, in which case the step
runs again. Only run.json and report.html contain times; every other file is a function
of the photograph, the options and the models' responses.
"""

import contextlib
import json
import logging
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from ..config import Config
from ..errors import NeoWorldError, RunError, choices
from ..io.files import content_hash, write_atomic, write_inside
from ..io.names import printable
from ..io.text_files import strict_json
from ..names import STEPS, Step
from ..progress import report
from .run_json import initial_record, read_run
from .staging import (
    STAGING,
    check_claimable,
    clear_unfinished,
    delete_files,
    disk_errors,
    keep_versions,
    later_writers,
    lock_folder,
    move_in,
    path_before,
    replaced_files,
    set_aside,
    step_of,
    versions,
    writes,
)

_log = logging.getLogger(__name__)

Mode = Literal["new", "resume", "redo", "overwrite"]
"""Treatment of an earlier run in the folder, see `RunFolder`."""
WAITED_S = 0.5
"""Least time of waiting for models that a progress message mentions [s]."""


class RunFolder:
    """An open, locked run folder. Use it in a `with` statement.

    Attributes:
        path: the folder.
        data: contents of run.json; `save` writes it.
        waited: function that returns the time spent waiting for models so far [s]; the caller that
            opens the models sets it.
    """

    waited: Callable[[], float]

    def __init__(
        self, path: Path, config: Config, mode: Mode = "new", *, step: str | None = None
    ) -> None:
        """Create the folder, or continue the run in it.

        Args:
            path: the folder; it may exist if it is empty or contains a run.
            config: options of the run.
            mode: treatment of an earlier run in the folder:

                - "new": refuse the run, unless it has finished no step;
                - "resume": keep finished steps whose inputs and files have not changed;
                - "redo": delete the files of `step` and of all later steps, and keep the earlier
                  steps even if their files were edited by hand;
                - "overwrite": delete the files of all steps.
            step: name of a step; required by "redo".

        Raises:
            RunError: the path is a file, is not writable, contains other files or a run that must
                not be modified, or is in use.
        """
        self.path = Path(path)
        self.waited = lambda: 0.0
        self._visited: set[str] = set()
        self._kept: tuple[str, ...] = ()
        """Steps that are kept even if their files were edited by hand."""
        if mode == "redo":
            if step not in STEPS:
                raise RunError(f"no such step: {choices(str(step), STEPS)}")
            self._kept = STEPS[: STEPS.index(step)]
        if self.path.exists() and not self.path.is_dir():
            raise RunError(f"{path} is a file; name a run folder or a folder that does not exist")
        with disk_errors(self.path, include_outside=True):
            check_claimable(self.path)
            if mode == "redo" and not (self.path / "run.json").exists():
                raise RunError(f"{path} contains no run to redo from {step}; omit --from")
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = lock_folder(self.path)
        try:
            with disk_errors(self.path):
                self._open(config, mode)
        except BaseException:
            self._lock.close()
            raise

    def __enter__(self) -> "RunFolder":
        """Return this folder."""
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Record the outcome of the run and unlock the folder."""
        shutil.rmtree(self.path / STAGING, ignore_errors=True)
        try:
            if error is None:
                self.save()
                return
            # A run in a thread gets a RuntimeError if Ctrl-C ends the interpreter.
            ended = isinstance(error, RuntimeError) and "shutdown" in str(error)
            interrupted = isinstance(error, KeyboardInterrupt) or ended
            self.data["status"] = "interrupted" if interrupted else "failed"
            expected = isinstance(error, NeoWorldError)
            cause = "KeyboardInterrupt" if interrupted else type(error).__name__
            self.data["error"] = str(error) if expected else cause
            with contextlib.suppress(RunError):  # Report the first error.
                self.save()
        finally:
            self._lock.close()

    def finished(self, name: str, inputs: Mapping[str, object]) -> bool:
        """Return True if `step` would reuse the stored result of this step; run nothing."""
        self._visited.add(name)
        return self._is_reusable(name, self._hashes(name, inputs))

    @contextlib.contextmanager
    def timed(self, step: Step) -> Iterator[None]:
        """Record the wall time of a step, unless all of its parts are kept."""
        before, began = self.data["steps"].copy(), time.perf_counter()
        waited = self.waited()
        try:
            yield
        finally:
            entries = self.data["steps"].items()
            if any(step_of(name) == step and before.get(name) is not e for name, e in entries):
                # If the clock is set back, negative times would make run.json invalid.
                seconds = max(time.perf_counter() - began, 0.0)
                waiting = max(self.waited() - waited, 0.0)
                times = {"seconds": round(seconds, 3), "waiting_s": round(waiting, 3)}
                self.data["times"][step] = times
                self.save()
                waits = f" and {waiting:.1f} s of waiting for models" if waiting >= WAITED_S else ""
                computing = max(seconds - waiting, 0.0)
                report(f"{step}: done in {computing:.1f} s{waits}", step=step)

    def begin(self, name: str) -> None:
        """Report that the work for a part of a step begins."""
        report(f"{name}: started", step=name)

    @contextlib.contextmanager
    def step(self, name: str, inputs: Mapping[str, object]) -> Iterator[Path | None]:
        """Run a step unless it is finished: `with run.step(...) as out: if out: ...`.

        Args:
            name: one of `STEPS`, or a part of a step, such as "program/cup".
            inputs: everything that determines the files that the step writes: paths of files or
                folders, whose contents are hashed, pydantic models and JSON values.

        Yields:
            An empty staging folder for the step's files, which are moved to the same relative paths
            in the run folder; None if the step is finished. An error in the block discards these
            files.

        Raises:
            RunError: an input is missing, or the disk is full or not writable.
        """
        if step_of(name) not in STEPS:
            raise RunError(f"no such step: {choices(name, STEPS)}")
        hashes = self._hashes(name, inputs)
        self._visited.add(name)
        if self._is_reusable(name, hashes):
            yield None
            return
        old_outputs = self._forget(name)
        staged = self.path / STAGING / name.replace("/", ".")
        with disk_errors(self.path):
            shutil.rmtree(staged, ignore_errors=True)
            staged.mkdir(parents=True)
            yield staged
            names = [
                path.relative_to(staged).as_posix() for path in staged.rglob("*") if path.is_file()
            ]
            unknown = [file for file in names if not writes(name, file)]
            if unknown:
                raise ValueError(f"step {name} wrote {unknown[0]}, which its pattern lacks")
            for other in sorted(later_writers(self.data["steps"], name, names)):
                self._discard(other)
            if keep_versions(self.path, self.data["steps"], name, names):
                self.save()
            outputs = move_in(staged, self.path)
            obsolete = set(old_outputs) - set(outputs)
            delete_files(self.path, obsolete)
            self._restore(obsolete)
        self.data["steps"][name] = {"inputs": hashes, "outputs": outputs}
        self.save()
        if name != step_of(name):
            report(f"{name}: done", step=step_of(name))

    def before(self, step: Step, name: str) -> Path:
        """Return the path of the version of a file that the steps before `step` left.

        This is the file itself, or, if `step` or a later step has replaced it, its earlier version
        in a folder `history`.
        """
        return self.path / path_before(self.data["steps"], step, name)

    def fallback(self, step: str, outcome: str, reason: str) -> None:
        """Record that a step did less than requested: its actual outcome, and the reason."""
        if self._add_entry("fallbacks", step, outcome, reason):
            _log.warning("%s", printable(f"{step}: {outcome}: {reason}"))

    def note(self, step: str, outcome: str, reason: str) -> None:
        """Record a noteworthy outcome of a step that did as requested, such as a large move."""
        if self._add_entry("notes", step, outcome, reason):
            report(printable(f"{step}: {outcome}: {reason}"))

    def _add_entry(self, kind: str, step: str, outcome: str, reason: str) -> bool:
        """Add an entry to a list of run.json; return True if it is new."""
        entry = strict_json({"step": step, "what": outcome, "why": reason})
        new = entry not in self.data[kind]
        if new:
            self.data[kind].append(entry)
        return new

    def record(self, section: str, **values: Any) -> None:
        """Update a section of run.json, such as "metrics"."""
        self.data.setdefault(section, {}).update(strict_json(values))

    def finish(self, until: str | None = None) -> None:
        """Mark the run as finished, or as stopped after step `until`.

        A finished run deletes the files of steps that it did not visit, for example those of an
        object that is no longer in the tree.
        """
        if until is None:
            for name in sorted(set(self.data["steps"]) - self._visited):
                if step_of(name) not in self._kept:
                    self._discard(name)
        self.data["status"] = "finished" if until is None else f"stopped after {until}"
        self.save()

    def save(self) -> None:
        """Write run.json atomically."""
        with disk_errors(self.path):
            text = json.dumps(strict_json(self.data), indent=1, allow_nan=False) + "\n"
            write_atomic(self.path / "run.json", text)

    def _open(self, config: Config, mode: Mode) -> None:
        """Read the earlier run, delete the steps that the mode does not keep, and save run.json."""
        self.data = {"steps": {}, "fallbacks": []}
        if (self.path / "run.json").exists():
            self.data = read_run(self.path)
            if mode == "new" and self.data["steps"]:
                raise RunError(
                    f"{self.path} contains a run ({self.data['status']}): continue it with "
                    "--resume, redo part of it with --from STEP, replace it with --overwrite, or "
                    "name another folder"
                )
            if mode == "new":  # The run finished no step. Continue it, to keep its costs.
                mode = "resume"
        if mode in ("redo", "overwrite"):
            for name in [*self.data["steps"]]:
                if step_of(name) not in self._kept:
                    self._discard(name)
        if mode in ("new", "overwrite"):
            (self.path / "report.html").unlink(missing_ok=True)
            self.data = {"steps": {}, "fallbacks": []}
        clear_unfinished(self.path)
        self._restore(replaced_files(self.data["steps"]))
        self.data = initial_record(config, self.data)
        self.save()

    def _is_reusable(self, name: str, hashes: dict[str, str]) -> bool:
        """Return True if a step is finished and unchanged, or accepted with its edits."""
        entry = self.data["steps"].get(name)
        if entry is None or not all((self.path / p).is_file() for p in entry["outputs"]):
            return False
        if step_of(name) in self._kept:
            if entry["inputs"] != hashes:
                _log.warning(
                    "%s: kept although its inputs have changed; --from %s uses them",
                    name,
                    step_of(name),
                )
            edited = self._edited(entry)
            if edited:  # Record the edits as outputs, so that a later --resume keeps them.
                entry["outputs"].update({path: content_hash(self.path / path) for path in edited})
                entry["edited"] = sorted({*entry.get("edited", []), *edited})
            entry["inputs"] = hashes
        elif entry["inputs"] != hashes or self._edited(entry):
            return False
        report(f"{name}: kept", step=step_of(name))
        return True

    def edited_by_hand(self, name: str) -> tuple[str, ...]:
        """Return the files of a finished step whose edits by hand were accepted."""
        return tuple(self.data["steps"].get(name, {}).get("edited", ()))

    def _edited(self, entry: dict[str, Any]) -> list[str]:
        """Return the step's files whose contents have changed since it wrote them."""
        return [
            name
            for name, written in entry["outputs"].items()
            if (self.path / name).is_file() and content_hash(self.path / name) != written
        ]

    def _discard(self, name: str) -> None:
        """Delete the record and the files of a step, and restore the files that it had replaced."""
        files = self._forget(name)
        delete_files(self.path, files)
        self._restore(files)

    def _forget(self, name: str) -> list[str]:
        """Delete the record of a step, and return its files.

        Files that were edited by hand are moved to `replaced/`. If steps are redone, an edited file
        that has an earlier version replaces this version instead.
        """
        for kind in ("fallbacks", "notes"):
            self.data[kind] = [entry for entry in self.data.get(kind, []) if entry["step"] != name]
        entry = self.data["steps"].pop(name, None)
        if entry is None:
            return []
        files = [*entry["outputs"]]
        with disk_errors(self.path):
            for path in self._edited(entry):
                earlier = versions(self.data["steps"], path)
                if earlier and step_of(earlier[-1][0]) in self._kept:
                    self._make_current(path, *earlier[-1])
                    files.remove(path)
                else:
                    aside = set_aside(self.path, path)
                    _log.warning(
                        "%s was edited after step %s wrote it: moved to %s", path, name, aside
                    )
        self.save()
        return files

    def _restore(self, names: Iterable[str]) -> None:
        """Put back the last earlier version of each file that no step has written since."""
        steps = self.data["steps"]
        with disk_errors(self.path):
            for name in names:
                found = versions(steps, name)
                writer, version = found[-1] if found else ("", name)
                if version != name and (self.path / version).is_file():
                    write_inside(self.path, name, (self.path / version).read_bytes())
                    self._make_current(name, writer, version)

    def _make_current(self, name: str, writer: str, version: str) -> None:
        """Make a file the output of the step that wrote its earlier version; delete the version."""
        outputs = self.data["steps"][writer]["outputs"]
        outputs[name] = outputs.pop(version)
        self.save()
        delete_files(self.path, [version])

    def _hashes(self, name: str, inputs: Mapping[str, object]) -> dict[str, str]:
        try:
            return {key: content_hash(value) for key, value in sorted(inputs.items())}
        except FileNotFoundError as error:
            raise RunError(
                f"step {name} needs {error.filename}, which is missing; "
                "repeat the step that writes it with --from STEP"
            ) from None
        except OSError as error:
            raise RunError(f"step {name} cannot read {error.filename}: {error.strerror}") from None
