"""The command line `neoworld`.

Exit codes: 0 if the command succeeds, 1 if the scene or object fails its checks, 2 if the input is
invalid, 70 for an internal error, 130 after an interrupt.
"""

import contextlib
import json
import logging
import os
import shutil
import sys
import textwrap
import traceback
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from . import __version__
from .commands import COMMANDS, load, summary
from .errors import choices, expected_message
from .progress import LOGGER

if TYPE_CHECKING:
    from .commands.base_command import Command

REPORT = (
    "This is a bug in neoworld. A run can continue with --resume. To report the bug, repeat the "
    "command with --debug and send its output and the output of neoworld doctor"
)
BAD_INPUT, FAILED, BUG, INTERRUPTED = 2, 1, 70, 130
MESSAGE = "interrupted; continue with --resume"


def main(args: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    # The matrices are so small that BLAS threads mainly wait for one another on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    args = sys.argv[1:] if args is None else args
    try:
        code = _run_words(args)
    except BrokenPipeError:  # The reader of a help text has stopped reading.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        code = 0
    except KeyboardInterrupt:  # Raised while modules are imported.
        print(f"error: {MESSAGE}", file=sys.stderr)
        code = INTERRUPTED
    if code == INTERRUPTED:
        sys.stderr.flush()
        os._exit(code)  # Do not wait for threads and exit functions of libraries.
    sys.exit(code)


def _run_words(args: Sequence[str]) -> int:
    """Run the command that `args` specify and return the exit code; exit if they are invalid."""
    texts = {"--version": lambda: f"neoworld {__version__}", "--help": help_text, "-h": help_text}
    if len(args) == 1 and args[0] in texts:
        print(texts[args[0]](), flush=True)
        return 0
    if not args or args[0] not in COMMANDS:
        print(f"error: {_no_command(args)}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    return run(parse(args[0], args[1:]))


def help_text() -> str:
    """Return the list of commands, wrapped to the terminal's width, without importing any."""
    width = min(shutil.get_terminal_size().columns, 100)
    column = max(map(len, COMMANDS)) + 4
    lines = [
        "usage: neoworld COMMAND [OPTIONS]",
        "",
        "Turns one photograph into a simulation-ready scene.",
        "",
        "commands:",
    ]
    for name in COMMANDS:
        first = f"  {name}".ljust(column)
        lines += textwrap.wrap(
            summary(name), width, initial_indent=first, subsequent_indent=" " * column
        )
    lines += ["", "COMMAND --help lists the options of COMMAND; --version prints the version"]
    return "\n".join(lines)


def _no_command(args: Sequence[str]) -> str:
    """Return the error message for arguments without a valid command."""
    from .io.names import printable

    if not args:
        return f"name a command: {', '.join(COMMANDS)}; see neoworld --help"
    name = choices(printable(args[0]), COMMANDS)
    if args[0].startswith("-"):
        return f"the command comes before its options; {name}"
    return f"no such command: {name}"


def parse(name: str, args: Sequence[str]) -> Any:
    """Parse the arguments of a command; exit if they are invalid."""
    import tyro
    from tyro.conf import DisallowNone, FlagCreatePairsOff, OmitSubcommandPrefixes

    command = load(name)
    verbs: dict[str, type] = getattr(command, "verbs", {})
    if args and args[0] in verbs:
        name, command, args = f"{name} {args[0]}", verbs[args[0]], args[1:]
    return tyro.cli(
        OmitSubcommandPrefixes[command],
        prog=f"neoworld {name}",
        args=args,
        config=(FlagCreatePairsOff, DisallowNone),
    )


def run(command: "Command") -> int:
    """Run a parsed command, print its result and return the exit code."""
    from .commands.terminal import details, prompt_interrupts
    from .io.names import printable
    from .io.text_files import strict_json

    if sys.stdout is None:  # pyright: ignore[reportUnnecessaryComparison] The caller closed it.
        print("error: cannot write to stdout: it is closed", file=sys.stderr)
        return BAD_INPUT
    reserved = contextlib.nullcontext(sys.stdout) if command.owns_stdout else _reserved_stdout()
    with reserved as out, _log_on_stderr(command):

        def end() -> None:
            os.write(2, f"error: {MESSAGE}\n".encode())
            if command.json:
                os.write(out.fileno(), f"{json.dumps({'error': MESSAGE})}\n".encode())
            os._exit(INTERRUPTED)

        try:
            with prompt_interrupts(None if command.ends_by_interrupt else end):
                command.check_inputs()
                result = command.run()
            code = FAILED if result.get("passed") is False else 0
        except KeyboardInterrupt:
            result, code = {"error": MESSAGE}, INTERRUPTED
        except Exception as error:
            if command.debug:
                traceback.print_exc()
            message, code = _describe(error)
            result = {"error": message}
        if "error" in result:
            print(f"error: {printable(str(result['error']))}", file=sys.stderr)
        try:
            if command.owns_stdout:
                pass
            elif command.json:
                print(json.dumps(strict_json(result)), file=out)
            elif "error" not in result:
                rest = [details(result)] * command.verbose
                print(printable("\n".join([*command.lines(result), *rest])), file=out)
            out.flush()
        except OSError as error:
            if not isinstance(error, BrokenPipeError):  # The reader has stopped reading.
                print(f"error: cannot write to stdout: {error.strerror}", file=sys.stderr)
                code = BAD_INPUT
            # Redirect the rest, so that closing the file does not fail again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())
    return code


def _describe(error: Exception) -> tuple[str, int]:
    """Return the message and the exit code for an error."""
    if (message := expected_message(error)) is not None:
        return message, BAD_INPUT
    return f"internal: {type(error).__name__}: {error}. {REPORT}", BUG


@contextlib.contextmanager
def _log_on_stderr(command: "Command") -> Iterator[None]:
    """Print the package's log on stderr, and show the progress in a status line."""
    from .commands.terminal import StatusLine

    log = logging.getLogger("neoworld_mjx")
    with StatusLine(sys.stderr, verbose=command.verbose, quiet=command.quiet) as handler:
        log.handlers = [handler]  # Replaces the handler of an earlier command in this process.
        log.setLevel(logging.INFO)
        logging.getLogger(LOGGER).setLevel(logging.DEBUG)
        yield


@contextlib.contextmanager
def _reserved_stdout() -> Iterator[Any]:
    """Reserve stdout for the result; other output of Python and C code goes to stderr."""
    sys.stdout.flush()
    stdout = os.dup(1)
    os.dup2(2, 1)
    try:
        with (
            contextlib.redirect_stdout(sys.stderr),
            os.fdopen(os.dup(stdout), "w", encoding="utf-8", errors="backslashreplace") as out,
        ):
            yield out
    finally:
        os.dup2(stdout, 1)
        os.close(stdout)


if __name__ == "__main__":
    main()
