"""Every iteration of a search in Weights & Biases; any other tracker takes the same callback.

Needs the extra `examples`. With WANDB_MODE=offline, the run stays in the folder `wandb`.
"""

import wandb

import neoworld_mjx as nw
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.sweeps import case

OPTIONS = RefineOptions.model_validate(
    {
        "cem": {"population": 16, "iterations": 3, "hold_resting": False},
        "settle": {"enabled": False},
        "rollout": {"engine": "native", "duration_s": 0.3},
    }
)

with wandb.init(project="neoworld", name="crowded:3", config=OPTIONS.model_dump()) as run:

    def log(step):
        """Log an iteration; a callback that returns True ends the search."""
        values = {"best": step.best, "mean": step.mean, "valid": step.valid}
        known = {name: value for name, value in (values | step.terms).items() if value is not None}
        run.log(known, step=step.number)

    refined = nw.refine(case("crowded:3").scene, OPTIONS, on_iteration=log)
    run.summary["passed"] = refined.passed
    print(f"{refined.iterations} iterations logged, passed: {refined.passed}")
