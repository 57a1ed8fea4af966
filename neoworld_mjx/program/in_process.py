"""Execution of a program by CPython in this process, without isolation."""

import contextlib
import io
import traceback

from ..checks.signals import Signal, error_signal
from ..config import ProgramOptions
from .exception_signals import exception_signal, limit_signal
from .session import LimitExceeded, Session, use_session


def run_in_process(
    text: str, session: Session, options: ProgramOptions
) -> tuple[str, list[Signal]]:
    """Run a program in this process, and return its printed text and its errors.

    The limits of `session` on parts and shapes apply. The limits on time, memory, recursion and SDK
    calls do not apply.
    """
    session.filename = "<program.py>"
    output = io.StringIO()
    try:
        code = compile(text, session.filename, "exec", dont_inherit=True)
        with contextlib.redirect_stdout(output), use_session(session):
            exec(code, {"__name__": "__main__", "__file__": "program.py"})
    except SyntaxError as error:
        signal = error_signal("syntax", str(error.msg), line=error.lineno, column=error.offset)
        return output.getvalue(), [signal]
    except (Exception, SystemExit) as error:
        return output.getvalue(), [_signal(error, session)]
    if session.exceeded is not None:
        return output.getvalue(), [limit_signal(session.exceeded, session)]
    return output.getvalue()[: options.max_output_bytes], []


def _signal(error: BaseException, session: Session) -> Signal:
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == session.filename]
    line = lines[-1] if lines else None
    if isinstance(error, LimitExceeded):
        return limit_signal(error, session).model_copy(update={"line": line})
    return exception_signal(error, line)
