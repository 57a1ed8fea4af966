"""Winners of many runs, chosen and checked side by side.

A final check simulates in C MuJoCo, which lets other threads run, but a third of it is Python's own
work. So many runs on many cores are checked in processes, and few of them in threads.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np

from ..config import RefineOptions
from ..measure import SceneMeasure
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..progress import report
from ..refinement.objective import open_objective, photograph_decides
from ..refinement.returning import Winner, choose_and_return
from ..refinement.rounds import Round
from ..refinement.scene_refinement import compile_for_search
from ..refinement.search_run import SearchResult
from ..spec import SceneSpec

CHECK_S, SERIAL_S, START_S = 0.9, 0.35, 10.0
"""Seconds of a core that a run's winner takes, those of them in which only one thread of a process
can work, and those that a process takes to start; the first two of coffee, on an AMD EPYC."""


class _Job(NamedTuple):
    """What the choice of a winner needs; see `choose_and_return`."""

    options: RefineOptions
    rounds: list[Round]
    start: Layout | None
    checked: SceneMeasure | None


def winners(
    scene: SceneSpec, reach: RefineOptions, model: SceneModel, results: Sequence[SearchResult]
) -> list[Winner]:
    """Choose every run's winner, and put back what it moved without need.

    Args:
        scene: the scene as composed.
        reach: the options that it was compiled with.
        model: the compiled scene.
        results: the runs' searches.
    """
    cores = os.cpu_count() or 1
    # Terms of the user's own may be known to this process alone.
    known = all(photograph_decides(r.problem.objective) for r in results)
    if known and processes_pay(len(results), cores):
        found = in_processes(scene, reach, results, min(cores, len(results)))
        if found is not None:
            return found
    with ThreadPoolExecutor(cores) as pool:
        return list(pool.map(lambda r: _winner(model, _job(r), r.problem.objective), results))


def processes_pay(runs: int, cores: int) -> bool:
    """Tell whether processes choose the winners of so many runs sooner than threads."""
    return START_S + runs * CHECK_S / cores < runs * max(SERIAL_S, CHECK_S / cores)


def in_processes(
    scene: SceneSpec, reach: RefineOptions, results: Sequence[SearchResult], processes: int
) -> list[Winner] | None:
    """Choose winners in processes on the CPU; None where one of them failed.

    They are no children of `multiprocessing`, which would run the caller's script again.
    """
    jobs = [_job(r) for r in results]
    shares = [jobs[k::processes] for k in range(processes)]
    command = [sys.executable, "-m", __name__]
    folders = [os.getcwd(), *filter(None, sys.path)]
    limits = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment = os.environ | limits | {"PYTHONPATH": os.pathsep.join(folders)}
    environment["JAX_PLATFORMS"] = "cpu"

    def choose(share: list[_Job]) -> list[Winner] | str:
        ran = subprocess.run(
            command,
            input=pickle.dumps((scene, reach, share)),
            capture_output=True,
            env=environment,
            check=False,
        )
        if ran.returncode:
            lines = ran.stderr.decode(errors="replace").strip().splitlines()
            return lines[-1] if lines else f"exit status {ran.returncode}"
        return pickle.loads(ran.stdout)

    with ThreadPoolExecutor(processes) as pool:
        found = list(pool.map(choose, shares))
    chosen: list[Any] = [None] * len(jobs)
    for k, own in enumerate(found):
        if isinstance(own, str):
            report(f"a process of final checks failed ({own}); they are made in this one")
            return None
        chosen[k::processes] = own
    return chosen


def _job(result: SearchResult) -> _Job:
    host = lambda tree: jax.tree.map(np.asarray, tree)
    run = result.run
    start = None if run.start is None else host(run.start)
    return _Job(run.options, [host(r) for r in result.rounds], start, result.checked)


def _winner(model: SceneModel, job: _Job, objective: Any) -> Winner:
    return choose_and_return(model, job.rounds, job.options, objective, job.start, job.checked)


def _choose_share() -> None:
    """Read a scene and jobs from standard input, and write their winners to standard output."""
    from ..cache import keep_compilations

    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # Whatever prints must not get between.
    keep_compilations()
    scene, reach, share = pickle.load(sys.stdin.buffer)
    model = compile_for_search(scene, reach)
    found = [_winner(model, job, open_objective(job.options)) for job in share]
    out.write(pickle.dumps(found))
    out.close()


if __name__ == "__main__":
    _choose_share()
