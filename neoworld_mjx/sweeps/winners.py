"""Choice of the winners of many runs, with their final checks, in processes or threads.

A final check simulates in C MuJoCo, which releases the GIL, but a third of the time is spent in
Python code. Many runs on many cores are therefore checked in processes, and few runs in threads.
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
from ..physics.layout import Layout
from ..physics.model import SceneModel
from ..progress import report
from ..refinement.choosing import Winner, choose_winner
from ..refinement.compiling import compile_for_search
from ..refinement.finishing import Finished
from ..refinement.rounds import Round
from ..refinement.search_run import SearchResult
from ..spec import SceneSpec

CHECK_S, SERIAL_S, START_S = 0.9, 0.35, 10.0
"""CPU time to choose the winner of a run, the part of it that holds the GIL, and start-up time of a
process [s]. The first two were measured for the example coffee on an AMD EPYC.
"""


class _Job(NamedTuple):
    """Arguments of `choose_winner` for one run."""

    options: RefineOptions
    rounds: list[Round]
    start: Layout | None
    initial: Finished
    searched: SceneSpec
    """Scene that was searched, in which some objects may be fixed."""
    accept_initial: bool


def winners(
    scene: SceneSpec,
    compile_options: RefineOptions,
    model: SceneModel,
    results: Sequence[SearchResult],
) -> list[Winner]:
    """Choose the winner of every run.

    Args:
        scene: the composed scene.
        compile_options: options with which the scene was compiled.
        model: the compiled scene.
        results: the searches of the runs.
    """
    cores = os.cpu_count() or 1
    if processes_are_faster(len(results), cores):
        chosen = choose_in_processes(scene, compile_options, results, min(cores, len(results)))
        if chosen is not None:
            return chosen
    with ThreadPoolExecutor(cores) as pool:
        return list(pool.map(lambda r: _winner(model, _job(r), r.scene), results))


def processes_are_faster(runs: int, cores: int) -> bool:
    """Return whether processes choose the winners of `runs` faster than threads."""
    return START_S + runs * CHECK_S / cores < runs * max(SERIAL_S, CHECK_S / cores)


def choose_in_processes(
    scene: SceneSpec,
    compile_options: RefineOptions,
    results: Sequence[SearchResult],
    processes: int,
) -> list[Winner] | None:
    """Choose winners in CPU processes; return None if a process fails.

    The processes are not started by `multiprocessing`, which would import the caller's script.
    """
    jobs = [_job(result) for result in results]
    path = os.pathsep.join([os.getcwd(), *filter(None, sys.path)])
    environment = os.environ | {"PYTHONPATH": path, "JAX_PLATFORMS": "cpu"}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def run_process(jobs_of_process: list[_Job]) -> list[Winner] | str:
        process = subprocess.run(
            [sys.executable, "-m", __name__],
            input=pickle.dumps((scene, compile_options, jobs_of_process)),
            capture_output=True,
            env=environment,
            check=False,
        )
        if process.returncode:
            lines = process.stderr.decode(errors="replace").strip().splitlines()
            return lines[-1] if lines else f"exit status {process.returncode}"
        return pickle.loads(process.stdout)

    with ThreadPoolExecutor(processes) as pool:
        outcomes = list(pool.map(run_process, [jobs[k::processes] for k in range(processes)]))
    chosen: list[Any] = [None] * len(jobs)
    for k, outcome in enumerate(outcomes):
        if isinstance(outcome, str):
            report(f"a process of final checks failed ({outcome}); checking in threads instead")
            return None
        chosen[k::processes] = outcome
    return chosen


def _job(result: SearchResult) -> _Job:
    start, rounds = jax.tree.map(np.asarray, (result.run.start, list(result.rounds)))
    return _Job(
        result.run.options, rounds, start, result.initial, result.scene.spec, result.accept_initial
    )


def _winner(model: SceneModel, job: _Job, searched: SceneModel) -> Winner:
    return choose_winner(
        model,
        job.rounds,
        job.options,
        job.initial,
        job.start,
        searched,
        accept_initial=job.accept_initial,
    )


def _choose_share() -> None:
    """Read a scene and jobs from standard input, and write the winners to standard output."""
    from ..cache import keep_compilations

    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # Other output goes to standard error, so that it does not mix with the winners.
    keep_compilations()
    scene, compile_options, jobs = pickle.load(sys.stdin.buffer)
    model = compile_for_search(scene, compile_options)
    searched = lambda job: compile_for_search(job.searched, compile_options)
    out.write(pickle.dumps([_winner(model, job, searched(job)) for job in jobs]))
    out.close()


if __name__ == "__main__":
    _choose_share()
