"""Faults that strike a run of the example at a random moment, and what is left afterwards.

    python -m tests.faults.strikes FIRST COUNT [STEP [PHOTO]]

strikes runs that end after a step, by default verify, and prints one JSON line for each fault; runs
that refine are struck by an engine that returns NaN, too. PHOTO is a file of `examples`, by default
coffee.png; microwave.jpg and drawers.png show things with joints.
A run happens in a forked process, so that it can be killed. The moment is counted in operations on
the run folder, in requests or in looks at the clock, so that a seed strikes the same moment again.
"""

import asyncio
import errno
import json
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, cast

from neoworld_mjx.cache import VARIABLE
from neoworld_mjx.config import load_config
from neoworld_mjx.errors import NeoWorldError
from neoworld_mjx.mllm.replay import Replay
from neoworld_mjx.mllm.requests import Reply, Usage
from neoworld_mjx.pipeline import reconstruct
from neoworld_mjx.step_names import Step

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = {
    "refine": {"cem": {"population": 16, "iterations": 2}, "rollout": {"duration_s": 0.3}},
    "render": {"width": 96, "supersample": 1},
    "verify": {"duration_s": 0.5},
}
TIMED = {"run.json", "report.html", "run.log", ".lock"}
"""What may differ between two runs, as it carries times or process numbers."""
CRITICS = ("judge", "critic")
NOTES = {"parse.json", "program.json", "verify.json", "answers.tape.json"}
"""Files that hold what critics said, beside what was made."""
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
FINISHED, REFUSED, INTERRUPTED, BROKEN = 0, 2, 130, 70


class Aim(NamedTuple):
    """What is struck."""

    until: Step
    photo: str = "coffee.png"


class Struck(NamedTuple):
    """A fault, where it struck and how it ended."""

    seed: int
    fault: str
    moment: str
    ended: str
    wrong: str
    """Empty if the run ended in one clear error or well, and the same files came in the end."""


class _Countdown:
    """Calls a function at the n-th event, and at all later ones if it is to stay."""

    def __init__(self, at: int, strike: Callable[[str], None], *, stays: bool = False) -> None:
        self.left, self.strike, self.stays = at, strike, stays
        self.note: Callable[[str], None] = lambda moment: None

    def __call__(self, moment: str) -> None:
        self.left -= 1
        if self.left == 0:
            self.note(moment)
        if self.left == 0 or (self.stays and self.left < 0):
            self.strike(moment)


def _on_files(out: Path, count: _Countdown) -> None:
    """Count what changes files of a folder; an error raised there is one of the disk."""
    inside = str(out)

    def note(event: str, details: tuple[Any, ...]) -> None:
        if event == "open":
            path, flags = details[0], details[2]
            writes = isinstance(path, str) and isinstance(flags, int) and flags & WRITES
            # Bare names lie in the run folder, which was opened before.
            if writes and (path.startswith(inside) or "/" not in path):
                count(f"writing {os.path.basename(path)[:24]}")
        elif event in ("os.rename", "os.mkdir", "os.remove", "os.rmdir"):
            path = str(details[0])
            if path.startswith(inside) or "/" not in path:
                count(f"{event} {os.path.basename(path)[:24]}")

    sys.addaudithook(note)


def _raising(code: int) -> Callable[[str], None]:
    def strike(moment: str) -> None:
        raise OSError(code, os.strerror(code))

    return strike


def _kill(moment: str) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _interrupt(moment: str) -> None:
    os.kill(os.getpid(), signal.SIGINT)


def _on_requests(count: _Countdown, reply: Callable[[], Any]) -> None:
    """Count requests; from the n-th on they are answered otherwise."""
    original = Replay.reply
    struck = []
    count.strike = lambda moment: struck.append(moment)

    async def replied(self: Any, request: Any, role: Any, rejected: Any) -> Reply:
        count(f"request {request.name}")
        if struck:
            given = reply()
            if asyncio.iscoroutine(given):
                given = await given
            if given is not None:
                return given
            struck.clear()
        return await original(self, request, role, rejected)

    Replay.reply = replied


def _lost() -> Reply:
    raise ConnectionError("the server is gone")


async def _slow() -> None:
    await asyncio.sleep(0.5)


def _nonsense() -> Reply:
    return Reply("I would rather talk about \ud800 the weather: {", Usage(), "tape")


def _jump(draw: random.Random) -> None:
    """Let all clocks jump at a later look at them."""
    ahead, at = draw.choice([-1e6, 1e3, 1e6, 1e9]), draw.randint(1, 40)
    for name in ("time", "perf_counter", "monotonic"):
        original, looks = getattr(time, name), [0]

        def jumped(original: Any = original, looks: list[int] = looks) -> float:
            looks[0] += 1
            return original() + (ahead if looks[0] >= at else 0.0)

        setattr(time, name, jumped)


def _sick_engine(count: _Countdown) -> None:
    """Count rollouts; one of them returns NaN for every position."""
    import equinox as eqx

    from neoworld_mjx.physics.native import NativeEngine

    original = NativeEngine.rollout
    struck: list[str] = []
    count.strike = struck.append

    def rollout(self: Any, *args: Any, **options: Any) -> Any:
        count("a rollout")
        rolled = original(self, *args, **options)
        if struck:
            struck.clear()
            rolled = eqx.tree_at(lambda r: r.pos, rolled, rolled.pos * float("nan"))
        return rolled

    NativeEngine.rollout = rollout


FAULTS = (
    *("kill", "interrupt", "full disk", "read-only", "lost provider", "slow provider"),
    *("nonsense", "clock", "two on a folder", "two on a cache"),
)
SEARCH_FAULTS = (*FAULTS, "engine NaN")
"""Faults of a run that refines."""
REFINES = ("refine", "export")


def run(out: Path, aim: Aim, log: int | None = None) -> int:
    """Go on with a run in this process, and return how it ended."""
    try:
        photo = EXAMPLES / aim.photo
        reconstruct(photo, out, load_config(None, SMALL), resume=True, until=aim.until)
        return FINISHED
    except NeoWorldError as error:
        code, text = REFUSED, str(error)
    except KeyboardInterrupt:
        code, text = INTERRUPTED, "interrupted"
    except BaseException as error:
        code, text = BROKEN, f"{type(error).__name__}: {error}\n{traceback.format_exc()[-1500:]}"
    if log is not None:
        os.write(log, json.dumps(text[:2000]).encode() + b"\n")
    return code


def forked(act: Callable[[int], int]) -> tuple[int, int]:
    """Start a process that ends with the code that `act` returns; give its number and log."""
    reader, writer = os.pipe()
    child = os.fork()
    if child:
        os.close(writer)
        return child, reader
    code = BROKEN
    try:
        os.close(reader)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        code = act(writer)
    finally:
        os._exit(code)


def ended(child: int, reader: int) -> tuple[int, list[str]]:
    """Wait for a process; return its code, negative for a signal, and the lines of its log."""
    with os.fdopen(reader) as stream:
        lines = [str(json.loads(line)) for line in stream.read().splitlines()]
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), lines


def strike(seed: int, home: Path, expected: dict[str, bytes], aim: Aim) -> Struck:
    """Strike a run by the fault of a seed, go on with it, and tell how both ended."""
    draw = random.Random(seed)
    faults = SEARCH_FAULTS if aim.until in REFINES else FAULTS
    fault = faults[seed % len(faults)]
    out = home / f"run{seed}"

    def act(log: int) -> int:
        def note(moment: str) -> None:
            os.write(log, json.dumps(f"struck at {moment}").encode() + b"\n")

        strikes = {"kill": _kill, "interrupt": _interrupt}
        disks = {"full disk": errno.ENOSPC, "read-only": errno.EROFS}
        replies = {"lost provider": _lost, "slow provider": _slow, "nonsense": _nonsense}
        count = _Countdown(draw.randint(1, 60), _kill)
        if fault in strikes:
            count = _Countdown(draw.randint(1, 60), strikes[fault])
            _on_files(out, count)
        elif fault in disks:
            count = _Countdown(draw.randint(1, 60), _raising(disks[fault]), stays=True)
            _on_files(out, count)
        elif fault in replies:
            count = _Countdown(draw.randint(1, 6), _kill)
            _on_requests(count, replies[fault])
        elif fault == "clock":
            _jump(draw)
        elif fault == "engine NaN":
            count = _Countdown(draw.randint(1, 4), _kill)
            _sick_engine(count)
        count.note = note
        return run(out, aim, log)

    others = []
    if fault.startswith("two"):
        place = out if fault == "two on a folder" else home / f"beside{seed}"
        others = [forked(lambda log: run(place, aim, log))]
    code, lines = ended(*forked(act))
    codes = [code, *(ended(*other)[0] for other in others)]
    moment = next((line for line in lines if line.startswith("struck at ")), "")
    text = next((line for line in lines if not line.startswith("struck at ")), "")
    allowed = {FINISHED, REFUSED, INTERRUPTED, -signal.SIGKILL}
    wrong = "" if set(codes) <= allowed else f"ended with {codes}: {text}"
    done = _stamps(out)
    code, lines = ended(*forked(lambda log: run(out, aim, log)))
    if code != FINISHED:
        wrong = wrong or f"going on ended with {code}: {lines}"
    elif differing := _differing(out, expected, searched=fault != "engine NaN"):
        wrong = wrong or f"going on made other files: {differing[:5]}"
    else:
        redone = [name for name, stamps in done.items() if _stamps(out).get(name) != stamps]
        if redone:
            wrong = wrong or f"finished steps were done again: {redone}"
    return Struck(seed, fault, moment.removeprefix("struck at "), text.split("\n")[0], wrong)


def _warm() -> None:
    """Import what runs need, once, before they are forked; nothing may start a thread."""
    names = (
        *("parse", "program.synthesise", "program.execution", "verify", "checks.simulation"),
        *("compose", "measure", "render", "fit.refit", "view.report.run_report"),
    )
    for name in names:
        import_module(f"neoworld_mjx.{name}")


def undisturbed(home: Path, aim: Aim) -> dict[str, bytes]:
    """Run the example once and return its files."""
    _warm()
    code, lines = ended(*forked(lambda log: run(home / "whole", aim, log)))
    if code != FINISHED:
        raise RuntimeError(f"the undisturbed run ended with {code}: {lines}")
    return contents(home / "whole")


def contents(out: Path) -> dict[str, bytes]:
    """Return the files of a run that do not depend on time."""
    files = [path for path in out.rglob("*") if path.is_file() and path.name not in TIMED]
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in files}


def _differing(out: Path, expected: dict[str, bytes], *, searched: bool) -> list[str]:
    """Return the files that are not as expected.

    A critic that gives no answer is a fallback on record: then the notes of its round may differ,
    and nothing else. A search that lost rollouts may end in another scene, which has passed the
    final check or is on record for not passing it; what came before it is the same.
    """
    actual = contents(out)
    names = [name for name in {*actual, *expected} if actual.get(name) != expected.get(name)]
    run = json.loads((out / "run.json").read_text(encoding="utf-8"))
    fallbacks = run["fallbacks"]
    if not searched:
        outputs = {
            name for step in REFINES for name in run["steps"].get(step, {}).get("outputs", ())
        }
        on_record = any(entry["step"] == "refine" for entry in fallbacks)
        if run["metrics"]["passed"] or on_record:
            names = [n for n in names if n not in outputs]
    if any(word in entry["what"] for entry in fallbacks for word in CRITICS):
        names = [n for n in names if n.rpartition("/")[2] not in NOTES]
    return sorted(names)


def _stamps(out: Path) -> dict[str, dict[str, int]]:
    """Return the finished steps, each with when its files were written."""
    path = out / "run.json"
    steps = json.loads(path.read_text(encoding="utf-8"))["steps"] if path.exists() else {}
    return {
        name: {file: (out / file).stat().st_mtime_ns for file in entry["outputs"]}
        for name, entry in steps.items()
    }


def main(first: int, count: int, aim: Aim) -> None:
    """Print what the faults of some seeds did."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        os.environ[VARIABLE] = str(home / "cache")
        expected = undisturbed(home, aim)
        for seed in range(first, first + count):
            row = strike(seed, home, expected, aim)._asdict() | aim._asdict()
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    first, count, *rest = sys.argv[1:]
    until, *photo = rest or ["verify"]
    main(int(first), int(count), Aim(cast(Step, until), *photo))
