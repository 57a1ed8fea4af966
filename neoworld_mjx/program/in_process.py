"""Run a program by CPython in this process, without isolation; the limits of the SDK hold."""

import contextlib
import io
import traceback

from ..checks.signals import Signal
from ..config import ProgramOptions
from .exception_signals import exception_signal, limit_signal
from .session import LimitExceeded, Session, entered


def run_in_process(
    text: str, session: Session, options: ProgramOptions
) -> tuple[str, list[Signal]]:
    """Run a program in this process, with all that Python can do.

    Args:
        text: the program.
        session: collects the objects that the program makes, and counts what it uses.
        options: the limits; those on the program's time, memory and recursion do not hold here.

    Returns:
        Printed text, and errors.
    """
    session.filename = "<program.py>"
    printed = io.StringIO()
    try:
        code = compile(text, session.filename, "exec", dont_inherit=True)
        with contextlib.redirect_stdout(printed), entered(session):
            exec(code, {"__name__": "__main__", "__file__": "program.py"})
    except SyntaxError as error:
        problem = Signal(
            severity="error",
            code="syntax",
            message=str(error.msg),
            line=error.lineno,
            column=error.offset,
        )
        return printed.getvalue(), [problem]
    except (Exception, SystemExit) as error:
        return printed.getvalue(), [_signal(error, session)]
    if session.exceeded is not None:
        return printed.getvalue(), [limit_signal(session.exceeded, session)]
    return printed.getvalue()[: options.max_output_bytes], []


def _signal(error: BaseException, session: Session) -> Signal:
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame.lineno for frame in frames if frame.filename == session.filename]
    line = own[-1] if own else None
    if isinstance(error, LimitExceeded):
        return limit_signal(error, session).model_copy(update={"line": line})
    return exception_signal(error, line)
