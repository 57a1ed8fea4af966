"""A run folder: written step by step and atomically, locked, resumable by content hashes.

A step writes into a staging folder; when it has finished, its files are flushed, moved into place
and its record goes into run.json: a hash of what it read and one of each file it wrote. A process
killed at any moment leaves either the record, and then all files, or no record, and then the step
is done again. Only run.json and report.html carry times; every other file is a function of the
photograph, the options and the models' answers.
"""

import contextlib
import errno
import fcntl
import json
import logging
import os
import platform
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any, Self

from .config import Config
from .errors import ExportError, NeoWorldError, RunError, choices
from .files import content_hash, disk_full, sync_folder, write_atomic

STEPS = ("parse", "program", "verify", "compose", "refine", "export")
FORMAT = "neoworld-run/1"

_LOCK, _STAGING = ".lock", ".staging"
_OURS = {_LOCK, _STAGING, ".run.json.part"}
_PACKAGES = (
    *("neoworld-mjx", "jax", "mujoco", "mujoco-mjx", "mujoco-warp", "warp-lang", "numpy", "scipy"),
    *("optax", "equinox", "trimesh", "usd-core", "yourdfpy", "anthropic", "pydantic"),
    *("pydantic-monty", "manifold3d", "pillow"),
)
_log = logging.getLogger(__name__)


class RunFolder:
    """An open, locked run folder. Use it in a `with` statement.

    Attributes:
        path: the folder.
        data: what run.json holds; `save` writes it.
    """

    def __init__(
        self,
        path: Path,
        config: Config,
        *,
        resume: bool = False,
        start: str | None = None,
        overwrite: bool = False,
    ):
        """Create the folder, or go on in one.

        Args:
            path: the folder; it may exist if it is empty or a run.
            config: the options of the run.
            resume: keep finished steps of an earlier run whose inputs have not changed.
            start: delete what this step of an earlier run and all after it wrote, to do them
                again; the steps before it are kept as their files stand, so edits by hand count.
            overwrite: delete what an earlier run wrote (and only that) and begin anew.

        Raises:
            RunError: the path is a file, cannot be written, holds something else or a run that may
                not be touched, or is in use.
        """
        if start is not None and start not in STEPS:
            raise RunError(f"no such step: {choices(start, STEPS)}")
        self.path = Path(path)
        self._touched: set[str] = set()
        self._kept = STEPS[: STEPS.index(start)] if start else ()
        if self.path.exists() and not self.path.is_dir():
            raise RunError(f"{path} is a file; name a folder that does not exist yet, or a run")
        with self._writing(anything=True):
            self._claimable()
            if start is not None and not (self.path / "run.json").exists():
                raise RunError(f"{path} holds no run to begin from {start}; leave --from out")
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(self.path)
        try:
            with self._writing():
                self._begin(config, resume or start is not None, start, overwrite)
        except BaseException:
            self._lock.close()
            raise

    def __enter__(self) -> Self:
        """Return the folder itself."""
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Record how the run ended and unlock."""
        shutil.rmtree(self.path / _STAGING, ignore_errors=True)
        try:
            if error is None:
                self.save()
                return
            stopped = isinstance(error, KeyboardInterrupt)
            self.data["status"] = "interrupted" if stopped else "failed"
            known = isinstance(error, NeoWorldError)
            self.data["error"] = str(error) if known else type(error).__name__
            with contextlib.suppress(RunError):  # The first error is the one to tell.
                self.save()
        finally:
            self._lock.close()

    def finished(self, name: str, inputs: Mapping[str, object]) -> bool:
        """Tell whether `step` would find this step finished, without beginning it."""
        self._touched.add(name)
        found = self._finished(name, self._hash_inputs(name, inputs))
        if found:
            _log.info("%s: kept as it is", name)
        return found

    @contextlib.contextmanager
    def step(
        self, name: str, inputs: Mapping[str, object], *, begun: float | None = None
    ) -> Iterator[Path | None]:
        """Do a step of the run, unless it is finished: `with run.step(...) as out: if out: ...`.

        Args:
            name: one of `STEPS`, or such a name and a part, as in "program/cup".
            inputs: everything that decides what the step writes: paths stand for the contents of
                that file or folder, pydantic models and JSON values for themselves.
            begun: `time.perf_counter()` when its work began, if before this call.

        Yields:
            An empty folder that stands for the run folder, to write the step's files into; None if
            the step is finished and its files are there. An error inside leaves no trace of it.

        Raises:
            RunError: an input is missing, or the disk is full or not writable.
        """
        if _head(name) not in STEPS:
            raise RunError(f"no such step: {choices(name, STEPS)}")
        hashed = self._hash_inputs(name, inputs)
        self._touched.add(name)
        if self._finished(name, hashed):
            _log.info("%s: kept as it is", name)
            yield None
            return
        begun = time.perf_counter() if begun is None else begun
        before = self._forget(name)
        out = self.path / _STAGING / name.replace("/", ".")
        with self._writing():
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir(parents=True)
            _log.info("%s: begun", name)
            yield out
            outputs = self._move_in(out)
            self._delete(set(before) - set(outputs))
        seconds = time.perf_counter() - begun
        self.data["steps"][name] = {
            "seconds": round(seconds, 3),
            "inputs": hashed,
            "outputs": outputs,
        }
        self.save()
        _log.info("%s: done in %.1f s", name, seconds)

    def fallback(self, step: str, what: str, why: str) -> None:
        """Record that a step had to do something lesser than asked."""
        entry = {"step": step, "what": what, "why": why}
        if entry not in self.data["fallbacks"]:
            self.data["fallbacks"].append(entry)
            _log.warning("%s: fell back to %s: %s", step, what, why)

    def record(self, section: str, **values: Any) -> None:
        """Put numbers, texts, lists and mappings into a section of run.json, such as "metrics"."""
        text = json.dumps(values, default=lambda value: value.item())
        plain = json.loads(text, parse_constant=lambda _: None)  # NaN and Infinity are no JSON.
        self.data.setdefault(section, {}).update(plain)

    def seconds(self) -> dict[str, float]:
        """Return the seconds each step took when it was last done; parts are added up."""
        total: dict[str, float] = {}
        for name, entry in self.data["steps"].items():
            total[_head(name)] = round(total.get(_head(name), 0.0) + entry["seconds"], 3)
        return total

    def finish(self, until: str | None = None) -> None:
        """Mark the run as finished, or as stopped after a step.

        What an earlier run left and a finished one did not come by (an object that is no longer in
        the tree) is deleted.
        """
        if until is None:
            for name in sorted(set(self.data["steps"]) - self._touched):
                if _head(name) not in self._kept:
                    self._delete(self._forget(name))
        self.data["status"] = "finished" if until is None else f"stopped after {until}"
        self.save()

    def save(self) -> None:
        """Write run.json atomically."""
        with self._writing():
            text = json.dumps(self.data, indent=1, allow_nan=False) + "\n"
            write_atomic(self.path / "run.json", text)

    def _claimable(self) -> None:
        """Refuse a folder that holds anything but a run, before a byte is written to it."""
        if not self.path.is_dir() or (self.path / "run.json").exists():
            return
        try:
            foreign = sorted({entry.name for entry in self.path.iterdir()} - _OURS)
        except OSError as error:
            raise RunError(f"cannot read {self.path}: {error.strerror}") from None
        if foreign:
            raise RunError(
                f"{self.path} is not empty and not a run folder (it holds {foreign[0]}); "
                "name a new or empty folder"
            )

    def _begin(self, config: Config, resume: bool, start: str | None, overwrite: bool) -> None:
        if (self.path / "run.json").exists():
            self.data = read_run(self.path)
            # A run that never finished a step has nothing to lose but its books of what it cost.
            resume = resume or not (overwrite or self.data["steps"])
            if not (resume or overwrite):
                raise RunError(
                    f"{self.path} holds a run ({self.data['status']}): go on with --resume, do "
                    "part of it again with --from STEP, replace it with --overwrite, or name "
                    "another folder"
                )
        else:
            self.data = {"steps": {}, "fallbacks": []}
        for name in [*self.data["steps"]]:
            if _head(name) not in self._kept if start is not None else overwrite and not resume:
                self._delete(self._forget(name))
        if not resume:
            (self.path / "report.html").unlink(missing_ok=True)
            self.data = {"steps": {}, "fallbacks": []}
        shutil.rmtree(self.path / _STAGING, ignore_errors=True)
        old = self.data
        self.data = {
            "format": FORMAT,
            "status": "running",
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "config": _shown(config),
            "fingerprint": config.fingerprint(),
            "seeds": {"run": config.seed},
            "versions": versions(),
            "device": {"machine": platform.machine(), "cores": os.cpu_count()},
            "metrics": {},
            **{key: old.get(key, {}) for key in ("mllm", "fallbacks", "steps")},
        }
        self.save()

    def _finished(self, name: str, hashed: dict[str, str]) -> bool:
        entry = self.data["steps"].get(name)
        if entry is None or not all((self.path / p).is_file() for p in entry["outputs"]):
            return False
        edited = self._changed(entry)
        if _head(name) not in self._kept:
            return entry["inputs"] == hashed and not edited
        if entry["inputs"] != hashed:
            _log.warning("%s: kept although what it reads has changed", name)
        if edited:  # So that a later --resume takes them too.
            entry["outputs"].update({path: content_hash(self.path / path) for path in edited})
            entry["edited"] = sorted({*entry.get("edited", []), *edited})
        entry["inputs"] = hashed
        return True

    def _changed(self, entry: dict[str, Any]) -> list[str]:
        found = entry["outputs"].items()
        there = [(self.path / name, name, old) for name, old in found]
        return [name for at, name, old in there if at.is_file() and content_hash(at) != old]

    def _forget(self, name: str) -> list[str]:
        """Drop a step's record and return its files; those edited by hand are set aside."""
        self.data["fallbacks"] = [f for f in self.data["fallbacks"] if f["step"] != name]
        entry = self.data["steps"].pop(name, None)
        if entry is None:
            return []
        with self._writing():
            for path in self._changed(entry):
                aside = self.path / "replaced" / path
                while aside.exists():
                    aside = aside.with_name(f"{aside.name}.old")
                aside.parent.mkdir(parents=True, exist_ok=True)
                os.replace(self.path / path, aside)
                _log.warning("%s was changed after step %s wrote it: now %s", path, name, aside)
        self.save()
        return list(entry["outputs"])

    def _delete(self, paths: Iterable[str]) -> None:
        for path in map(self.path.joinpath, paths):
            path.unlink(missing_ok=True)
            for folder in path.parents:
                if folder == self.path or not folder.is_dir() or any(folder.iterdir()):
                    break
                folder.rmdir()

    def _hash_inputs(self, name: str, inputs: Mapping[str, object]) -> dict[str, str]:
        try:
            return {key: content_hash(value) for key, value in sorted(inputs.items())}
        except FileNotFoundError as error:
            raise RunError(
                f"step {name} needs {error.filename}, which is missing; "
                "do the step that makes it again with --from STEP"
            ) from None

    def _move_in(self, out: Path) -> dict[str, str]:
        files = sorted(path for path in out.rglob("*") if path.is_file())
        outputs, folders = {}, set()
        for path in files:
            with path.open("rb") as handle:
                os.fsync(handle.fileno())
            outputs[path.relative_to(out).as_posix()] = content_hash(path)
        for name in outputs:
            target = self.path / name
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(out / name, target)
            folders.add(target.parent)
        for folder in sorted(folders):
            sync_folder(folder)
        shutil.rmtree(out, ignore_errors=True)
        return outputs

    @contextlib.contextmanager
    def _writing(self, *, anything: bool = False) -> Iterator[None]:
        """Turn a disk's refusals into one message."""
        try:
            yield
        except (OSError, RuntimeError, ExportError) as error:
            code = error.errno if isinstance(error, OSError) else None
            # Some writers hide a full disk in an error of their own.
            if code in (errno.ENOSPC, errno.EDQUOT) or disk_full(self.path):
                raise RunError(
                    f"no space left on the disk of {self.path}: free some, then go on with --resume"
                ) from error
            named = str(getattr(error, "filename", None) or self.path)
            inside = anything or named.startswith(str(self.path))
            if isinstance(error, OSError) and inside:
                raise RunError(
                    f"cannot write {named}: {error.strerror}; name a folder that you may write to"
                ) from error
            raise


def read_run(path: Path) -> dict[str, Any]:
    """Read a folder's run.json.

    Raises:
        RunError: the folder is missing or not a run folder of this version.
    """
    file = Path(path) / "run.json"
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise RunError(
            f"{path} is not a run folder: cannot read run.json: {error.strerror}"
        ) from None
    except ValueError:
        data = None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise RunError(f"{file} is not a run of this version ({FORMAT}); name another folder")
    return data


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed packages that decide results."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def _shown(config: Config) -> dict[str, Any]:
    """Dump the options without header values, which may be keys under names nobody foresaw."""
    data = config.model_dump(mode="json")
    data["mllm"]["headers"] = {
        name: value if value.startswith("${") else "[hidden]"
        for name, value in data["mllm"]["headers"].items()
    }
    return data


def _head(name: str) -> str:
    return name.split("/", maxsplit=1)[0]


def _locked(path: Path) -> Any:
    handle = (path / _LOCK).open("a+")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        handle.seek(0)
        owner = handle.read().strip() or "unknown"
        handle.close()
        raise RunError(
            f"{path} is in use by another run (process {owner}); wait for it or name another folder"
        ) from None
    handle.truncate(0)
    handle.write(str(os.getpid()))
    handle.flush()
    return handle
