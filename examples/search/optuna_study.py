"""A study: Optuna (arXiv:1907.10902) chooses options of the search, and ends poor trials early.

Needs the extra `examples`. With `storage="sqlite:///study.db"`, several processes share one study.
"""

import statistics

import optuna

import neoworld_mjx as nw

TRIALS = 4
SCENES = ("crowded:2", "crowded:3")
CEM = {"population": 16, "iterations": 2, "hold_resting": False}
ROLLOUT = {"engine": "native", "duration_s": 0.2}
BASE = {"refine": {"cem": CEM, "rollout": ROLLOUT, "settle": {"enabled": False}}}


def objective(trial):
    """Return the mean reward of the winning candidates over scenes and seeds."""
    axes = {
        "refine.cem.sigma_xy": [trial.suggest_float("sigma_xy", 0.01, 0.2, log=True)],
        "refine.cem.elite_ratio": [trial.suggest_float("elite_ratio", 0.1, 0.5)],
    }
    rewards = []
    for step, scene in enumerate(SCENES):
        found = nw.sweep({"scenes": [scene], "seeds": 2, "base": BASE, "axes": axes})
        rewards += [row["reward"] for row in found.rows]
        trial.report(statistics.mean(rewards), step)
        if trial.should_prune():
            raise optuna.TrialPruned
    return statistics.mean(rewards)


if __name__ == "__main__":
    pruner = optuna.pruners.SuccessiveHalvingPruner(min_resource=1, reduction_factor=2)
    sampler = optuna.samplers.TPESampler(seed=0)
    study = optuna.create_study(direction="maximize", sampler=sampler, pruner=pruner)
    study.optimize(objective, n_trials=TRIALS)
    print(f"{len(study.trials)} trials, best reward {study.best_value:.3f} at {study.best_params}")
