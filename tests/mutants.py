"""Measure which share of small faults in the core rooms the tests notice.

    python3 -m tests.mutants --n 300 --workers 2 --out mutants.jsonl

A worker applies a mutant (`support/mutations.py`) to its own copy of the repository and runs files
of tests until a test fails: those named after the module, those of its room that import it, the
rest of its room, then those of other rooms that import it (`tests/test_*.py`, which read sources
as text and run everything, are not among them); quick ones first within each group, and as many as
take a third of the limit unmutated. A mutant is killed, too, if they take three times
as long as unmutated and over a minute; it is undecided if the limit is shorter than that.

Every file runs unmutated first; tests that fail are left out and listed. So does one selection of
each room as a whole, a control. Rows are written as they come, and a second call goes on.
"""

import argparse
import contextlib
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple

from tests.support.mutations import ROOMS, ROOT, Mutant, draw

NOT_COPIED = (".*", "dist", "__pycache__")
NO_TESTS = 5
"""Exit code of pytest if every test is left out."""


class Ended(NamedTuple):
    """Exit code of pytest, None after a time-out; failed tests; time [s]; end of the output."""

    code: int | None
    failing: list[str]
    seconds: float
    said: str


def groups(module: str) -> list[list[str]]:
    """Return the files of tests of a module, in the groups that are run one after the other."""
    parts = Path(module.removesuffix("/__init__.py")).with_suffix("").parts[1:]
    name, dotted = parts[-1], re.escape(".".join(parts))
    package = re.escape(".".join(("neoworld_mjx", *parts[:-1])))
    imports = re.compile(
        rf"neoworld_mjx\.{dotted}(?![\w.])"
        rf"|from {package} import (?:\([^)]*|[^\n(]*)\b{name}\b"
    )
    own = ROOT / "tests" / {"io": "outside"}.get(parts[0], parts[0])
    found: list[list[str]] = [[], [], [], []]
    for path in sorted((ROOT / "tests").glob("*/test_*.py")):
        inside = path.parent == own
        if inside and path.stem.startswith(f"test_{name}"):
            group = 0
        elif imports.search(path.read_text()):
            group = 1 if inside else 3
        elif inside:
            group = 2
        else:
            continue
        found[group].append(str(path.relative_to(ROOT)))
    return found


def select(module: str, files: dict[str, dict[str, Any]], limit: float) -> list[dict[str, Any]]:
    """Return the rows of the files to run for a module, the first in any case."""
    selected, total = [], 0.0
    for group in groups(module):
        for row in sorted((files[path] for path in group), key=lambda row: row["seconds"]):
            if row["usable"] and (not selected or total + row["seconds"] <= limit / 3):
                selected.append(row)
                total += row["seconds"]
    return selected


def run_tests(home: Path, paths: list[str], left_out: list[str], limit: float, *stop: str) -> Ended:
    """Run files of tests in the copy `home / "copy"`, at most `limit` seconds."""
    shutil.rmtree(home / "tmp", ignore_errors=True)
    (home / "tmp").mkdir()
    copied = home / "copy"
    places = (copied, copied / "kernels", copied / "benchmarks", os.environ.get("PYTHONPATH", ""))
    variables = {
        "PYTHONPATH": os.pathsep.join(map(str, places)),
        # Warnings of further plugins would count as errors.
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        "PYTEST_PLUGINS": "anyio.pytest_plugin",
        "NEOWORLD_CACHE": str(home / "tmp" / "cache"),
        "TMPDIR": str(home / "tmp"),
    }
    command = [sys.executable, "-m", "pytest", *paths, *stop, "-q", f"--basetemp={home}/tmp/pytest"]
    # conftest.py keeps there what a module compiles to, by its text.
    command += ["-o", f"cache_dir={home}/kept", *(f"--deselect={test}" for test in left_out)]
    began = time.monotonic()
    with (home / "output.txt").open("w+", errors="replace") as output:
        process = subprocess.Popen(
            command,
            cwd=copied,
            env=os.environ | variables,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        if hasattr(os, "sched_setaffinity"):  # Else libraries start a thread for every core.
            cores = sorted(os.sched_getaffinity(0))
            os.sched_setaffinity(process.pid, {cores[int(home.name) % len(cores)]})
        try:
            code = process.wait(limit)
        except subprocess.TimeoutExpired:
            code = None
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # With whatever a test started and left.
        process.wait()
        output.seek(0)
        said = output.read()
    failing = re.findall(r"^(?:FAILED|ERROR) (\S+\.py(?:::.*?)?)(?: - .*)?$", said, re.M)
    return Ended(code, failing, round(time.monotonic() - began, 1), said[-1000:])


def run_file(home: Path, limit: float, path: str) -> dict[str, Any]:
    """Return the row of a file of tests that runs unmutated."""
    ended = run_tests(home, [path], [], limit)
    usable = ended.code in (0, 1) and path not in ended.failing
    said = {} if usable else {"said": ended.said}
    row = {"file": path, "usable": usable, "failing": ended.failing, "seconds": ended.seconds}
    return row | said


def run_mutant(
    home: Path, limit: float, mutant: Mutant, files: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return the row of a mutant; the operator `none` changes nothing, for a control."""
    paths = [row["file"] for row in files]
    unmutated = round(sum(row["seconds"] for row in files), 1)
    left_out = [test for row in files for test in row["failing"]]
    changed, before = home / "copy" / mutant.module, (ROOT / mutant.module).read_bytes()
    after = mutant.apply(before)
    changed.write_bytes(after)
    # Bytecode counts as fresh if whole seconds and size agree; no other mutant has this time.
    os.utime(changed, (mutant.start, mutant.start))
    limit = min(limit, max(60.0, 3 * unmutated))
    ended = run_tests(home, paths, left_out, limit, "-x") if paths else Ended(NO_TESTS, [], 0.0, "")
    shutil.copy2(ROOT / mutant.module, changed)
    outcome = "survived" if ended.code in (0, NO_TESTS) else "killed"
    too_slow = ended.code is None and 3 * unmutated > limit
    if too_slow or (ended.code == NO_TESTS and any(groups(mutant.module))):
        outcome = "not decided"
    by = "time-out" if ended.code is None else [*ended.failing, f"exit {ended.code}"][0]
    return {
        **mutant._asdict(),
        "before": before.splitlines()[mutant.line - 1].decode().strip(),
        "after": after.splitlines()[mutant.line - 1].decode().strip(),
        "outcome": outcome,
        "by": by if outcome == "killed" else None,
        "seconds": ended.seconds,
        "unmutated_seconds": unmutated,
        "files": paths,
    }


def wilson(k: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a share of `k` of `n`."""
    z = 1.96
    middle, half = k + z * z / 2, z * math.sqrt(k * (n - k) / n + z * z / 4)
    return (middle - half) / (n + z * z), (middle + half) / (n + z * z)


def summary(rows: list[dict[str, Any]], n: int) -> str:
    """Return the score of each room and of all, and what was not run."""
    said = [f"left out: {test}" for row in rows for test in row.get("failing", ())]
    said += [f"not run: {row['file']}" for row in rows if not row.get("usable", True)]
    done = [row for row in rows if "operator" in row]
    controls = [row for row in done if row["operator"] == "none"]
    done = [row for row in done if row["operator"] != "none"]
    said += [f"control fails: {r['by']}, {r['module']}" for r in controls if r["by"]]
    for room in (*ROOMS, ""):
        own = [row["outcome"] for row in done if row["module"].startswith(f"neoworld_mjx/{room}")]
        killed, decided = own.count("killed"), len(own) - own.count("not decided")
        if decided:
            low, high = wilson(killed, decided)
            share = f"{killed} of {decided} killed, {100 * killed / decided:.1f} %"
            said.append(f"{room or 'all'}: {share} ({100 * low:.0f} to {100 * high:.0f})")
    undecided = sum(row["outcome"] == "not decided" for row in done)
    return "\n".join([*said, f"{len(done)} of {n} run, {undecided} not decided"])


def run(options: argparse.Namespace, homes: Path) -> str:
    """Run what has no row yet, until the time is over, and return the summary."""
    ends = time.monotonic() + options.limit_s
    options.out.touch()
    rows = [json.loads(line) for line in options.out.read_text().splitlines()]
    drawn = draw(options.rooms, options.n, options.seed)
    firsts = {mutant.module.split("/")[1]: mutant.module for mutant in reversed(drawn)}
    drawn += [Mutant(module, 1, "none", 0, 0, "") for module in firsts.values()]
    tests = {path for mutant in drawn for group in groups(mutant.module) for path in group}
    free: SimpleQueue[Path] = SimpleQueue()
    for number in range(options.workers):
        free.put(homes / str(number))

    def work(task: Callable[[Path, float], dict[str, Any]]) -> None:
        home = free.get()
        if not home.exists():
            shutil.copytree(ROOT, home / "copy", ignore=shutil.ignore_patterns(*NOT_COPIED))
        left = ends - time.monotonic()
        row = task(home, min(options.each_s, left)) if left > 0 else {}
        free.put(home)
        if time.monotonic() < ends:
            rows.append(row)
            with options.out.open("a") as out:
                out.write(json.dumps(row) + "\n")

    with ThreadPoolExecutor(options.workers) as pool:
        known = {row.get("file") for row in rows}
        order = sorted(tests - known, key=lambda path: (-(ROOT / path).stat().st_size, path))
        todo = [partial(run_file, path=path) for path in order]
        list(pool.map(work, todo))
        files = {row["file"]: row for row in rows if "file" in row}
        if tests <= files.keys():
            known = {tuple(row[name] for name in Mutant._fields) for row in rows if "line" in row}
            chosen = {mutant: select(mutant.module, files, options.each_s) for mutant in drawn}
            todo = [mutant for mutant in drawn if tuple(mutant) not in known]
            list(pool.map(work, [partial(run_mutant, mutant=m, files=chosen[m]) for m in todo]))
    return summary(rows, options.n)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--n", type=int, default=300, help="number of mutants")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rooms", nargs="+", choices=ROOMS, default=ROOMS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--limit-s", type=float, default=math.inf, help="time of this call")
    parser.add_argument("--each-s", type=float, default=240.0, help="time of each mutant")
    parser.add_argument("--out", type=Path, default=Path("mutants.jsonl"))
    with tempfile.TemporaryDirectory() as homes:
        print(run(parser.parse_args(), Path(homes)))


if __name__ == "__main__":
    main()
