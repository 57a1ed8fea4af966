"""Options of Step 5: search, rewards, rollouts, semantic scores and the final check.

These are traced, static or of the host; `tests/sweeps/test_grouping.py` checks the declarations
against the parameters that the search really compiles with.
"""

from typing import Literal

from ..engines import ENGINES_HELP, EngineChoice
from ..options import Options, PaperDifference, option, static, traced

_PROGRAM, _SHAPE = "is another program", "shapes arrays"
_EARLY_STOP = "ends rollouts early"
"""Traced in the reward, but `rollout.early_stop` ends the rollouts of all candidates by it."""


class CEMOptions(Options):
    """The Cross-Entropy Method (Algorithm 1 and Appendix B of the paper)."""

    population: int = static(_SHAPE, 256, "Candidates of an iteration.", ge=2, le=100_000)
    iterations: int = option(8, "Largest number of iterations.", ge=1, le=10_000)
    elite_ratio: float = static(
        _SHAPE, 0.05, "Elites over candidates: K = elite_ratio * population.", gt=0, le=1
    )
    sigma_xy: float = traced(
        0.05,
        "Initial standard deviation of x and y.",
        unit="the object's horizontal bounding-box diagonal",
        ge=0,
    )
    sigma_yaw_deg: float = traced(
        15.0, "Initial standard deviation of the yaw angle.", unit="deg", ge=0
    )
    sigma_log_scale: float = traced(
        0.1, "Initial standard deviation of the logarithm of the scale.", ge=0
    )
    sigma_agreeing: float = traced(
        0.3,
        "Share of the initial standard deviations of yaw and scale, for objects that overlap "
        "nothing and hold still where the search starts, or whose boxes agree with the "
        "photograph's. 1 where `keep_sound` is false.",
        gt=0,
        le=1,
        difference=PaperDifference(
            1.0,
            "An answer whose boxes agree is seldom off by more.",
            "heading after the search 1.90 and 2.29 deg, valid 20 and 18 of 20 rendered scenes "
            "(with 0.25; scenes 0 to 19)",
        ),
    )
    sigma_floor: float = traced(
        0.02,
        "Smallest standard deviation, as a fraction of the initial one.",
        ge=0,
        difference=PaperDifference(
            0.0, "Elites that agree in one number would freeze it for the rest of the search."
        ),
    )
    smoothing: float = traced(
        0.0,
        "Weight of the old mean and standard deviation in the update; 0 is Algorithm 1.",
        ge=0,
        lt=1,
    )
    zero_candidate: bool = static(
        _PROGRAM,
        True,
        "Always evaluate the mean itself as a candidate; at first that is the composed layout.",
        difference=PaperDifference(False, "What nothing is wrong with should be found at once."),
    )
    first: int = static(
        _SHAPE,
        32,
        "Population of the first iteration, if smaller than `population`: that iteration mostly "
        "shows where the initial layout fails, and the optimizer learns nothing from it. 0 is "
        "`population`.",
        ge=0,
        difference=PaperDifference(
            0,
            "It mostly shows where the layout fails, and fewer candidates tell that.",
        ),
    )
    credit: Literal["auto", "scene", "object", "island"] = static(
        _PROGRAM,
        "auto",
        "Reward that elites are chosen by. scene: the scene's. object: for each object that of the "
        "terms that it takes part in. island: that of all objects that it may come to touch. auto: "
        "the scene's from the first valid candidate on, by object before.",
        difference=PaperDifference(
            "scene",
            "While nothing is valid, each object learns from the candidates that are good for it.",
        ),
    )
    prune: bool = option(
        True,
        "Do not roll out candidates that cannot become elites; changes no elite. Only with "
        "`normalisation: fixed`, with reward terms that all have a bound, and without scores by a "
        "model.",
        difference=PaperDifference(
            False, "Candidates that cannot become elites need no rollout; the elites stay the same."
        ),
    )
    batch: int = option(16, "Candidates rolled out at once while pruning.", ge=1)
    stop_by: Literal["best", "elites"] = option(
        "best",
        "Whose gain ends the search. best: that of the best valid candidate so far. elites: that "
        "of the elites' mean absolute reward, as in Algorithm 1.",
        difference=PaperDifference("elites", "The result is the best candidate, not the elites."),
    )
    stop_gain: float = traced(
        0.005, "Stop when an iteration gains less absolute reward than this.", ge=0
    )
    patience: int = option(2, "Iterations in a row that must gain less; 1 is Algorithm 1.", ge=1)
    keep_sound: bool = option(
        True,
        "Leave objects alone that overlap nothing, hold still, and agree with the photograph where "
        "they stand; they are let go when two iterations without them found nothing valid, first "
        "those that the others may come to touch. What only disagrees with the photograph moves "
        "once the others are valid. Algorithm 1 moves all, and so do reward terms of "
        "your own, scores by a model and other optimizers.",
        difference=PaperDifference(
            False, "What stands where the photograph shows it can only be moved away from there."
        ),
    )


class DescentOptions(Options):
    """Gradient refinement (Adam) of the differentiable terms, before physics."""

    warm_steps: int = static(
        _PROGRAM,
        100,
        "Steps of the initial layout towards the photograph's boxes and out of penetration; 0 "
        "starts at the composed scene.",
        ge=0,
        difference=PaperDifference(
            0, "Gradients of boxes and penetration show the way that draws have to find."
        ),
    )
    project: Literal["never", "needed", "always"] = static(
        _PROGRAM,
        "needed",
        "Move candidates out of penetration: never, always, or in iterations before the first "
        "valid candidate (needed).",
        difference=PaperDifference(
            "never", "Hardly any draw of a crowded scene is free of interpenetration by itself."
        ),
    )
    project_steps: int = static(
        _PROGRAM, 6, "Steps that move a candidate out of penetration.", ge=1
    )
    rate: float = static(
        _PROGRAM, 0.2, "Length of a step.", unit="initial standard deviations", gt=0
    )
    samples: int = static(
        _SHAPE, 64, "Surface samples of an object in these steps.", ge=8, le=10_000
    )


class RewardOptions(Options):
    """R(z) = w_sem S_sem - w_pen D_pen - w_drift D_drift (Section 3.3 of the paper)."""

    w_sem: float = traced(1.0, "Weight of S_sem, the agreement with the photograph.", ge=0)
    w_pen: float = traced(1.0, "Weight of D_pen, the penetration.", ge=0)
    w_drift: float = traced(1.0, "Weight of D_drift, the displacement in the rollout.", ge=0)
    w_prior: float = traced(
        0.3,
        "Weight of the prior, the distance to the initial layout: the mean of (z / sigma)^2 over "
        "objects and their four numbers, sigma being the initial standard deviation.",
        ge=0,
        difference=PaperDifference(
            0.0,
            "What physics leaves open would wander, and all shrink to overlap less.",
        ),
    )
    normalisation: Literal["iteration", "fixed"] = static(
        _PROGRAM,
        "fixed",
        "Normalisation of D_pen and D_drift. iteration: over the candidates of the iteration. "
        "fixed: by the caps below.",
        difference=PaperDifference(
            "iteration", "Rewards of iterations can be compared, and bounded before physics."
        ),
    )
    d_pen_cap_m: float = traced(0.005, "D_pen is clipped here.", unit="m", gt=0)
    d_drift_cap: float = traced(
        3.0,
        "D_drift is clipped here: 3 is 3 cm or 15 degrees. A small cap keeps the difference "
        "between a valid candidate and one that just fails visible beside that between two bad "
        "ones.",
        unit="drift scales",
        reason=_EARLY_STOP,
        gt=0,
    )
    drift_free: float = traced(
        0.1,
        "Drift of an object that costs nothing: 0.1 is the millimetre and half degree by which "
        "objects settle when they are set down.",
        unit="drift scales",
        ge=0,
        difference=PaperDifference(
            0.0,
            "Everything settles a little, which would cost valid candidates reward.",
        ),
    )
    pen_scale_m: float = traced(
        0.001,
        "Scale of D_pen in the absolute reward, by which iterations are compared.",
        unit="m",
        gt=0,
    )
    drift_scale_m: float = traced(
        0.01,
        "Scale of displacement in D_drift.",
        unit="m",
        reason=_EARLY_STOP,
        gt=0,
    )
    tilt_scale_deg: float = traced(
        5.0, "Scale of rotation in D_drift.", unit="deg", reason=_EARLY_STOP, gt=0
    )
    terms: dict[str, float] = traced(
        {},
        "Further reward terms and their weights: your own by import path "
        '"package.module:function", built-in ones by name. Weights are traced; other terms are '
        "another program.",
    )


class RolloutOptions(Options):
    """Free-fall rollouts of candidate layouts."""

    engine: EngineChoice = static(_PROGRAM, "auto", f"{ENGINES_HELP}.")
    duration_s: float = static(
        "all candidates of a rollout share it",
        1.0,
        "Simulated time; 0 evaluates candidates without simulation, so that only the final check "
        "sees whether they are stable.",
        unit="s",
        ge=0,
        le=100,
    )
    timestep_s: float = static(
        "belongs to the compiled scene",
        0.004,
        "Time step of the simulation.",
        unit="s",
        ge=1e-4,
        le=0.1,
    )
    record_every_s: float = static(_SHAPE, 0.1, "Time between recorded poses.", unit="s", ge=0.001)
    early_stop: bool = static(
        _PROGRAM,
        True,
        "End a candidate's rollout once it has settled, lingers past the bounds of stability, or "
        "has drifted past the cap.",
        difference=PaperDifference(
            False, "Most candidates rest or have failed long before the time is over."
        ),
    )
    samples_per_object: int = static(
        _SHAPE, 256, "Surface samples of an object for D_pen.", ge=16, le=10_000
    )


class SemanticOptions(Options):
    """S_sem: how well candidates agree with the photograph."""

    scorer: Literal["geometric", "mllm"] = option(
        "geometric",
        "geometric: from the parsed boxes and depths, for every candidate. mllm: the critic scores "
        "a picture of the best candidates while physics runs; needs a photograph.",
        difference=PaperDifference(
            "mllm",
            "A call for each candidate is slow and dear; geometry scores all for nothing.",
        ),
    )
    top: int = option(
        8,
        "Candidates of an iteration that the model scores; a surrogate scores the others.",
        ge=1,
        difference=PaperDifference(
            256, "With scores by a model, it looks at the best candidates of an iteration alone."
        ),
    )
    wait: Literal["all", "bounded", "none"] = option(
        "all",
        "Scores that are waited for before elites are taken: all that were requested, those that "
        "are `late` iterations old (bounded), or none.",
    )
    late: int = option(
        1, "With `wait: bounded`, iterations that a score may be late; 0 is `wait: all`.", ge=0
    )
    picture_px: int = option(
        320,
        "Width of a candidate's picture; drawing it takes time from physics on the same CPU.",
        unit="px",
        ge=64,
    )
    shadows: bool = option(
        False,
        "Draw shadows and grain instead of flat colours with outlines, at five times the cost.",
    )
    timeout_s: float = option(
        90.0, "Longest time for a score with all its retries, once sent.", unit="s", gt=0
    )
    give_up_after: int = option(
        5, "Failed scores in a row after which no more are requested.", ge=1
    )
    max_cost_usd: float | None = option(
        None,
        "No more scores are requested once they have cost this much; those in flight still "
        "arrive. `mllm.max_cost_usd` is the limit that no request may exceed. null is no limit.",
        unit="USD",
        gt=0,
    )


class RefineOptions(Options):
    """Step 5 as a whole: search, rewards, rollouts and the final check."""

    optimizer: str = static(
        _PROGRAM,
        "cem",
        "cem, cma_es (extra `baselines`), random, or the import path of your own, "
        '"package.module:function", which builds one from the scene and the options `cem`.',
    )
    cem: CEMOptions = CEMOptions()
    descent: DescentOptions = DescentOptions()
    reward: RewardOptions = RewardOptions()
    rollout: RolloutOptions = RolloutOptions()
    semantic: SemanticOptions = SemanticOptions()
    check_duration_s: float = option(
        2.0, "Simulated time of the final check.", unit="s", gt=0, le=100
    )
    check_timestep_s: float = option(
        0.002, "Time step of the final check.", unit="s", ge=1e-4, le=0.1
    )
    max_drift_m: float = option(0.01, "Largest displacement in the final check.", unit="m", gt=0)
    max_tilt_deg: float = option(5.0, "Largest rotation in the final check.", unit="deg", gt=0)
    max_depth_m: float = traced(
        0.001, "Largest penetration of a valid candidate and in the final check.", unit="m", gt=0
    )
    settle: Literal["never", "needed", "always"] = option(
        "needed",
        "Let candidates come to rest before they are judged: never, always, or from the second "
        "iteration on while nothing is valid (needed). They sink with drag for the time of a "
        "rollout, and what they show, how deep they are in one another and how far they drift "
        "counts from there. Settling counts as drift, and a candidate is not valid in which an "
        "object comes to rest tilted by more than 15 degrees, a quarter of its size beside, or a "
        "tenth of it and 1 cm above or below its place. They do so 64 at a time, "
        "those first that agree best with the photograph, until one is valid; once one has been "
        "valid, only the first 64 do, and the others are left out.",
        difference=PaperDifference(
            "never",
            "What leans, lies in a cup or rolls rests at a tilt that no layout has; only gravity "
            "finds it.",
            "with it 23 of 30 starts valid; 11 before it and two smaller mends (n = 30 scenes)",
        ),
    )
    finalists: int = option(
        16,
        "Number of the best candidates that may be tried in the final check.",
        ge=1,
        difference=PaperDifference(
            1,
            "The best one by coarse rollouts may fail the finer check, and the next pass.",
        ),
    )
    returns: int = option(
        8,
        "Final checks to spend on putting back what the search moved without need: where the scene "
        "stays valid and agrees as well with the photograph. 0 leaves it where the winner has it, "
        "and so do reward terms of your own, and scores by a model.",
        ge=0,
        difference=PaperDifference(0, "What is right where it was composed should not be moved."),
    )
