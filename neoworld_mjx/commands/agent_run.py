"""A run that an agent answers: it computes in a thread, and the agent answers its mailbox.

The mailbox is the only channel between the agent and the run. An agent's folder contains one
current run, which `.neoworld-agent.json` names, so a restarted server continues it. All paths that
an agent names must lie inside the folder.
"""

import io
import logging
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from ..config import WITHOUT_CRITICS, Config, load_config, merged
from ..errors import ConfigError, NeoWorldError, PhotoError, RunError
from ..io import read_model
from ..io.files import write_inside
from ..io.names import file_name
from ..mllm.mailbox_client import forget_waiting, open_requests
from ..names import Step
from ..progress import LOGGER
from ..run_folder import Result
from .terminal import StatusLine

if TYPE_CHECKING:
    from ..evidence.evidence_file import StatedEvidence
    from ..evidence.known_camera import KnownCamera
    from ..parse.photo import Photo

_log = logging.getLogger(__name__)
PACKAGE = __name__.partition(".")[0]
SESSION = ".neoworld-agent.json"
FIXED = ("provider", "mllm", "files", "program.language")
"""Options that an agent may not set: they name servers and files, or run programs elsewhere."""
MAILBOX = "mailbox"


class _Session(BaseModel):
    """Arguments of `AgentRun.start`, as stored in the agent's folder."""

    photo: str
    out: str
    evidence: str = ""
    options: dict[str, Any] = {}
    fast: bool = False


@dataclass
class _Computation:
    """A reconstruction in a thread."""

    session: _Session
    ended: threading.Event = field(default_factory=threading.Event)
    result: Result | None = None
    error: str = ""


class AgentRun:
    """The current run of an agent's folder.

    Args:
        folder: the folder that contains the photographs, the runs and the exports.

    Raises:
        RunError: `folder` is no folder.
    """

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise RunError(f"{folder} is not a folder; name the folder of your photographs")
        self.folder = folder.resolve()
        self._latest: _Computation | None = None
        self._lock = threading.RLock()
        self._progress = StatusLine(io.StringIO(), quiet=True)

    def path(self, text: str) -> Path:
        """Return a path that an agent named.

        Raises:
            RunError: the path leads out of the folder.
        """
        try:
            path = (self.folder / text).resolve()
            path.exists()  # Raises OSError if the system refuses the name.
        except (OSError, ValueError, RuntimeError):
            raise RunError(f"{text[:80]!r} is not a path") from None
        if not path.is_relative_to(self.folder):
            raise RunError(
                f"{text!r} is outside the folder of this server, {self.folder}: copy the file "
                "there, or start the server with another --folder"
            )
        return path

    def start(
        self,
        photo: str,
        out: str = "",
        evidence: str = "",
        options: dict[str, Any] | None = None,
        fast: bool = False,
    ) -> None:
        """Begin the run of a photograph, or continue it.

        Args:
            photo: the photograph in the folder, or the name of a bundled example.
            out: run folder in the folder; by default NAME-scene.
            evidence: evidence file in the folder, which names files in the folder.
            options: nested options that differ from the defaults.
            fast: if True, ask no critics.

        Raises:
            NeoWorldError: the photograph, the folder or the options are invalid, or another run
                computes.
        """
        out = out or f"{file_name(Path(photo).stem) or 'photo'}-scene"
        session = _Session(
            photo=photo, out=out, evidence=evidence, options=options or {}, fast=fast
        )
        with self._lock:
            if self._latest is not None and not self._latest.ended.is_set():
                if session == self._latest.session:
                    return
                raise RunError(
                    f"the run in {self._latest.session.out} computes or waits for you: answer its "
                    "requests, or restart the server to begin another run"
                )
            self._photo(session)
            if self.path(out) == self.folder:
                raise RunError(f"out: {out!r} is the folder of this server; name a new folder")
            self._config(session)
            self._evidence(session)
            self._begin(session)
            write_inside(self.folder, SESSION, session.model_dump_json(indent=1) + "\n")

    def repeat(self, step: Step) -> None:
        """Repeat a step of the current run and all later steps.

        Raises:
            RunError: there is no run, or it still computes.
        """
        with self._lock:
            if not self._current().ended.is_set():
                raise RunError("the run still computes: answer its requests first; see status()")
            self._begin(self._current().session, step)

    def current(self) -> Path:
        """Return the folder of the current run. A run that was cut off continues.

        Raises:
            NeoWorldError: there is no run, or it cannot continue.
        """
        return self.path(self._current().session.out)

    def with_scene(self, *files: str) -> Path:
        """Return the folder of the current run, which contains one of the files of a scene.

        Raises:
            RunError: there is no scene yet.
        """
        out = self.current()
        if not any((out / file).is_file() for file in files):
            raise RunError(f"no scene yet: {self.state()}")
        return out

    def photo(self) -> "tuple[Photo, KnownCamera | None]":
        """Return the photograph as the run uses it, and what the evidence says about its camera."""
        from ..pipeline.given_evidence import known_photo

        path = self._photo(self._current().session)
        photo, known = known_photo(path, self.config(), None, self.current())
        return photo, known.evidence.camera

    def config(self) -> Config:
        """Return the options of the current run."""
        return self._config(self._current().session)

    @property
    def mailbox(self) -> Path:
        """The mailbox of the current run."""
        return self._mailbox(self._current().session)

    @property
    def error(self) -> str:
        """Reason why the current run has stopped; empty if it has not, or has finished."""
        return self._current().error

    @property
    def result(self) -> Result | None:
        """Result of the current run; None if it computes or has failed."""
        return self._current().result

    def wait(self, seconds: float) -> None:
        """Wait until all requests that the run has sent are open, or the run has ended."""
        mailbox, ended, end = self.mailbox, self._current().ended, time.monotonic() + seconds
        while not ended.is_set() and time.monotonic() < end:
            # The pictures of requests that were sent together are drawn one after another.
            if len(open_requests(mailbox)) >= max(self._progress.unanswered, 1):
                return
            ended.wait(min(0.2, seconds))

    def progress(self) -> str:
        """Return the progress of the run that computes; empty if none does."""
        computes = self._latest is not None and not self._latest.ended.is_set()
        return self._progress.text() if computes else ""

    def state(self) -> str:
        """Return the state of the current run in one line."""
        run = self._current()
        if not run.ended.is_set():
            names = open_requests(self._mailbox(run.session))
            if names:
                state = f"waits for you: {', '.join(names)}"
            elif self._progress.unanswered:
                state = "prepares requests for you: call next_request()"
            else:
                state = f"computes: {self._progress.text() or 'starts'}"
        else:
            result = run.result
            state = f"stopped: {run.error}" if result is None else f"finished: {result.verdict}"
        return f"{run.session.out}: {state}"

    def _current(self) -> _Computation:
        with self._lock:
            if self._latest is None:
                path = self.folder / SESSION
                if not path.is_file():
                    raise RunError("no run: call start(photo) first")
                session = read_model(path, _Session, RunError, "a session")
                self.start(**session.model_dump())
            assert self._latest is not None
            return self._latest

    def _mailbox(self, session: _Session) -> Path:
        return self.path(f"{session.out}/{MAILBOX}")

    def _photo(self, session: _Session) -> Path:
        from ..pipeline.bundled_examples import bundled_examples

        path, examples = self.path(session.photo), bundled_examples()
        if path.is_file():
            return path
        if session.photo not in examples:
            raise PhotoError(
                f"photo: {session.photo!r} is neither a file in {self.folder} nor an example: "
                f"{', '.join(examples)}"
            )
        return examples[session.photo].photo

    def _evidence(self, session: _Session) -> "StatedEvidence | None":
        from ..evidence.evidence_file import read_stated

        if not session.evidence:
            return None
        return read_stated(self.path(session.evidence), self.path)

    def _config(self, session: _Session) -> Config:
        from ..pipeline.reconstruction import refuse_code

        for key in FIXED:
            group, _, name = key.partition(".")
            given = session.options.get(group, {})
            if group in session.options and (
                not name or (isinstance(given, dict) and name in given)
            ):
                raise ConfigError(f"options: {key} is fixed in an agent's run")
        options = merged(WITHOUT_CRITICS if session.fast else {}, session.options)
        config = load_config(None, options | {"provider": "mailbox"})
        refuse_code(config, "options")
        return config

    def _begin(self, session: _Session, step: Step | None = None) -> None:
        """Start the thread that computes a run."""
        forget_waiting(self._mailbox(session))
        self._latest = _Computation(session)
        log = logging.getLogger(PACKAGE)
        if self._progress not in log.handlers:
            log.addHandler(self._progress)
            log.setLevel(logging.INFO)
            logging.getLogger(LOGGER).setLevel(logging.DEBUG)
        # A daemon: the process may end at any time, as a run folder survives that.
        threading.Thread(target=self._compute, args=(self._latest, step), daemon=True).start()

    def _compute(self, computation: _Computation, step: Step | None) -> None:
        from ..cache import keep_compilations
        from ..pipeline import reconstruct

        session = computation.session
        try:
            keep_compilations()
            computation.result = reconstruct(
                self._photo(session),
                self.path(session.out),
                self._config(session),
                resume=step is None,
                start=step,
                evidence=self._evidence(session) if step is None else None,
            )
        except NeoWorldError as error:
            computation.error = str(error)
        except Exception as error:
            _log.exception("the run failed")
            computation.error = f"internal: {type(error).__name__}: {error}"
        finally:
            computation.ended.set()
