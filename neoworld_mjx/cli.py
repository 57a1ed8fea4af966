"""The command `neoworld`: parse, run, print one answer, exit 0, 1 or 2.

0 is good, 1 says that the scene fails its checks, 2 that the input is wrong.
"""

import contextlib
import difflib
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
from .commands import COMMANDS
from .commands.status_line import StatusLine
from .errors import NeoWorldError
from .io.names import printable
from .progress import LOGGER

if TYPE_CHECKING:
    from .commands.base_command import CommandResult, Runnable

REPORT = (
    "This is a fault of neoworld, not of your input. A run can go on with --resume. To report it, "
    "run the same command with --debug and send what it prints with the output of neoworld doctor"
)
BAD_INPUT, FAILED, BUG, INTERRUPTED = 2, 1, 70, 130


def main(args: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    args = sys.argv[1:] if args is None else args
    if list(args) == ["--version"]:
        print(f"neoworld {__version__}")
        sys.exit(0)
    if list(args) in (["--help"], ["-h"]):
        print(help_text())
        sys.exit(0)
    if not args or args[0] not in COMMANDS:
        print(f"error: {_no_command(args)}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    refusal = getattr(COMMANDS[args[0]].load(), "refusal", None)
    reason = refusal(args[1:]) if refusal else None
    if reason is not None:
        print(f"error: {reason}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    sys.exit(run(parse(args[0], args[1:])))


def help_text() -> str:
    """Return the list of commands, as wide as the terminal, without importing any of them."""
    width = min(shutil.get_terminal_size().columns, 100)
    column = max(map(len, COMMANDS)) + 4
    lines = [
        "usage: neoworld COMMAND [OPTIONS]",
        "",
        "One photograph in, a scene out that a robot can touch.",
        "",
        "commands:",
    ]
    for name, entry in COMMANDS.items():
        first = f"  {name}".ljust(column)
        lines += textwrap.wrap(
            entry.summary, width, initial_indent=first, subsequent_indent=" " * column
        )
    lines += ["", "neoworld COMMAND --help lists a command's options; neoworld --version"]
    return "\n".join(lines)


def _no_command(args: Sequence[str]) -> str:
    """Say what is wrong with arguments that name no command."""
    if not args:
        return f"name a command: {', '.join(COMMANDS)}; neoworld --help says what each does"
    wrong, choices = printable(args[0]), f"choices: {', '.join(COMMANDS)}"
    if wrong.startswith("-"):
        return f"the command comes before its options, got {wrong!r} first; {choices}"
    near = difflib.get_close_matches(wrong, COMMANDS, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ";"
    return f"there is no command {wrong!r}{hint} {choices}"


def parse(name: str, args: Sequence[str]) -> Any:
    """Return the command of a name and its arguments; what is wrong with them ends the process."""
    import tyro
    from tyro.conf import DisallowNone, FlagCreatePairsOff, OmitSubcommandPrefixes

    return tyro.cli(
        OmitSubcommandPrefixes[COMMANDS[name].load()],
        prog=f"neoworld {name}",
        args=args,
        config=(FlagCreatePairsOff, DisallowNone),
    )


def run(command: "Runnable") -> int:
    """Run a parsed command, print its answer and return the exit code."""
    with _reserved_stdout() as out, _shown_progress(command):
        try:
            answer = command.run()
            code = FAILED if answer.get("passed") is False else 0
        except NeoWorldError as error:
            _show_traceback(command)
            answer, code = {"error": str(error)}, BAD_INPUT
        except MemoryError:
            _show_traceback(command)
            lack = "there is not enough memory: ask for less, such as fewer candidates, a shorter "
            answer, code = {"error": f"{lack}duration or a smaller picture"}, BAD_INPUT
        except KeyboardInterrupt:
            answer, code = {"error": "interrupted; go on with --resume"}, INTERRUPTED
        except Exception as error:
            _show_traceback(command)
            answer, code = {"error": f"internal: {type(error).__name__}: {error}. {REPORT}"}, BUG
        if "error" in answer:
            print(f"error: {printable(str(answer['error']))}", file=sys.stderr)
        try:
            if command.json:
                # NaN and Infinity are no JSON: they become null.
                strict = json.loads(json.dumps(answer), parse_constant=lambda _: None)
                print(json.dumps(strict), file=out)
            elif "error" not in answer:
                with contextlib.redirect_stdout(out):
                    _show(command, answer)
            out.flush()
        except BrokenPipeError:
            # Whoever reads has read enough, as `head` does; closing must not try once more.
            os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())
    return code


def _show_traceback(command: "Runnable") -> None:
    if getattr(command, "debug", False):
        traceback.print_exc()


@contextlib.contextmanager
def _shown_progress(command: "Runnable") -> Iterator[None]:
    """Send the package's log to stderr as plain lines, and the progress to a status line."""
    log = logging.getLogger("neoworld_mjx")
    with StatusLine(sys.stderr, verbose=command.verbose, quiet=command.quiet) as handler:
        log.handlers = [handler]  # Not added: a second command in one process would say all twice.
        log.setLevel(logging.INFO)
        logging.getLogger(LOGGER).setLevel(logging.DEBUG)
        yield


@contextlib.contextmanager
def _reserved_stdout() -> Iterator[Any]:
    """Keep stdout for the answer: what Python or a C library prints meanwhile goes to stderr."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with (
            contextlib.redirect_stdout(sys.stderr),
            os.fdopen(os.dup(kept), "w", encoding="utf-8", errors="backslashreplace") as out,
        ):
            yield out
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def _show(command: "Runnable", answer: "CommandResult") -> None:
    """Print an answer for people: in few lines, or with all details."""
    lines = None if command.verbose else command.lines(answer)
    if lines is None:
        _print(answer)
    else:
        print(printable("\n".join(lines)))


def _print(answer: "CommandResult", indent: str = "") -> None:
    """Print an answer for people."""
    for key, value in answer.items():
        if isinstance(value, dict):
            print(f"{indent}{key}:")
            _print(value, indent + "  ")
        elif key in _TABLES and isinstance(value, list) and value:
            print(f"{indent}{key}:")
            _table(value, _TABLES[key], indent + "  ")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            print(f"{indent}{key}:")
            for item in value:
                print(f"{indent}  - " + ", ".join(f"{k} {_plain(v)}" for k, v in item.items()))
        else:
            print(f"{indent}{key}: {_plain(value)}")


_TABLES = {
    "checks": (
        "outcome",
        "doubtful",
        "scenario",
        "name",
        "value",
        "threshold",
        "unit",
        "fault",
        "hint",
    ),
    "points": ("point", "n", "passed", "reward", "d_drift", "s_sem", "rollouts", "seconds"),
    "differences": ("point", "n", "passed", "reward", "d_drift", "s_sem", "rollouts", "seconds"),
    "missing": ("what", "costs", "mend"),
    "examples": ("name", "objects", "joints", "shows", "licence", "photo"),
    "matrix": ("kind", "n", "detected", "named", "repaired"),
}
"""Lists that are shown as a table, and their columns; those that no row has are left out."""


def _table(rows: "list[CommandResult]", columns: Sequence[str], indent: str) -> None:
    """Print rows in columns."""
    used = [name for name in columns if any(name in row for row in rows)]
    if not used:
        used = list(rows[0])
    cells = [used] + [[_plain(row[n]) if n in row else "" for n in used] for row in rows]
    widths = [max(len(line[k]) for line in cells) for k in range(len(used))]
    for line in cells:
        shown = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        print((indent + "  ".join(shown)).rstrip())


def _plain(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value)) or "none"
    if isinstance(value, float):
        return f"{value:.5g}"
    if value is None or isinstance(value, bool):
        return {None: "unknown", True: "yes", False: "no"}[value]
    return printable(str(value))


if __name__ == "__main__":
    main()
