"""Options of Step 5: search, rewards, rollouts, semantic scores and the final check."""

from typing import Literal

from ..engines import ENGINES_HELP, EngineChoice
from ..options import Options, PaperDifference, option

NARROW = "A search varies what the photograph leaves open, not what it shows exactly."
"""Reason for deviations of the estimate in place of the paper's."""
SIGMA_XY, SIGMA_YAW_DEG, SIGMA_LOG_SCALE = 0.05, 15.0, 0.1
"""Initial standard deviations in Appendix B of the paper; units as those of the options."""


class CEMOptions(Options):
    """Options of the Cross-Entropy Method (Algorithm 1 and Appendix B of the paper)."""

    population: int = option(64, "Number of candidates per iteration.", ge=2, le=100_000)
    iterations: int = option(8, "Maximum number of iterations.", ge=1, le=10_000)
    elite_ratio: float = option(
        0.125,
        "Fraction of candidates that are elites: K = elite_ratio * population.",
        gt=0,
        le=1,
    )
    sigma_xy: float | None = option(
        None,
        "Initial standard deviation of x and y. The default is that of the estimate, at most 0.05; "
        "0.05 for objects that were not aligned with the photograph.",
        unit="the object's horizontal bounding-box diagonal",
        ge=0,
        difference=PaperDifference(SIGMA_XY, NARROW),
    )
    sigma_yaw_deg: float | None = option(
        None,
        "Initial standard deviation of the yaw angle. The default is that of the estimate, at most "
        "15; 15 for objects that were not aligned.",
        unit="deg",
        ge=0,
        difference=PaperDifference(SIGMA_YAW_DEG, NARROW),
    )
    sigma_log_scale: float | None = option(
        None,
        "Initial standard deviation of the logarithm of the scale. The default is that of the "
        "estimate, at most 0.1; 0.1 for objects that were not aligned.",
        ge=0,
        difference=PaperDifference(SIGMA_LOG_SCALE, NARROW),
    )
    hold_resting: bool = option(
        True,
        "Fix the objects that rest in the settled initial layout, so that only the other objects, "
        "and the objects that these support, move. "
        "With further reward terms, scores by a model, or an optimizer that is passed from Python, "
        "all objects move.",
        difference=PaperDifference(
            False, "Moving an object that already rests where it should can only make it worse."
        ),
    )
    widest: float = option(
        8.0,
        "The Gaussian of an object is fitted to the best candidates in which the object rests. "
        "While it rests in none, its standard deviations of x and y double in every iteration, up "
        "to this multiple of the initial ones. 1 disables both, as in Algorithm 1: all objects are "
        "fitted to the same candidates.",
        ge=1,
        le=1000,
        difference=PaperDifference(
            1.0,
            "In a scene of many objects, hardly any candidate is good for all; and samples from "
            "too narrow a Gaussian never reach a support that is beside the object.",
        ),
    )
    stop_by: Literal["best", "elites"] = option(
        "best",
        "Quantity whose gain decides when the search stops. best: the reward of the best valid "
        "candidate so far. elites: the mean reward of the elites, as in Algorithm 1.",
        difference=PaperDifference(
            "elites", "The result is the best candidate; the mean of the elites does not matter."
        ),
    )
    stop_gain: float = option(
        0.005,
        "Gain of the quantity of `stop_by` over the previous iteration below which the search "
        "ends. 0 runs all iterations.",
        ge=0,
    )


class RewardOptions(Options):
    """Options of the reward R(z) = w_sem S_sem - w_pen D_pen - w_drift D_drift (Section 3.3)."""

    w_sem: float = option(1.0, "Weight of S_sem, the agreement with the photograph.", ge=0)
    w_pen: float = option(1.0, "Weight of D_pen, the penetration.", ge=0)
    w_drift: float = option(1.0, "Weight of D_drift, the displacement in the rollout.", ge=0)
    w_prior: float = option(
        0.3,
        "Weight of the prior, the mean of (z / sigma)^2 over all objects and their four variables. "
        "z is the distance of a variable from the initial layout, and sigma is its initial "
        "standard deviation.",
        ge=0,
        difference=PaperDifference(
            0.0,
            "Without the prior, unconstrained variables drift, and objects shrink to reduce "
            "penetration.",
        ),
    )
    normalisation: Literal["iteration", "fixed"] = option(
        "fixed",
        "Normalization of D_pen and D_drift, which enter the reward as D / (D + scale). fixed: "
        "none further. iteration: for the choice of the elites, their ranges over the candidates "
        "of an iteration are mapped to [0, 1].",
        difference=PaperDifference(
            "iteration", "Rewards are comparable between iterations, and so are their elites."
        ),
    )
    d_pen_scale_m: float = option(
        0.005, "Scale of D_pen, at which it costs half of its weight.", unit="m", gt=0
    )
    d_drift_scale: float = option(
        3.0,
        "Scale of D_drift, at which it costs half of its weight; 3 is 3 cm or 15 degrees. A "
        "rollout that stops early ends at this drift of an object.",
        unit="max_drift_m or max_tilt_deg",
        gt=0,
    )
    terms: dict[str, float] = option(
        {},
        'Further reward terms by their import paths "package.module:function", and their weights. '
        "Weights are traced; a change of the terms recompiles.",
    )


class RolloutOptions(Options):
    """Options of the free-fall rollouts of candidate layouts."""

    engine: EngineChoice = option("auto", f"{ENGINES_HELP}.")
    duration_s: float = option(
        1.0,
        "Simulated time. If 0, candidates are scored without simulation, and only the final check "
        "tests stability.",
        unit="s",
        ge=0,
        le=100,
    )
    timestep_s: float = option(
        0.004,
        "Time step of the simulation.",
        unit="s",
        ge=1e-4,
        le=0.1,
    )
    record_every_s: float = option(0.1, "Time between recorded poses.", unit="s", ge=0.001)
    early_stop: bool = option(
        True,
        "End the rollout of a candidate as soon as its objects have settled, linger beyond the "
        "stability bounds, or have drifted by `reward.d_drift_scale`.",
        difference=PaperDifference(
            False, "Most candidates settle or fail long before the end of the rollout."
        ),
    )
    samples_per_object: int = option(
        256, "Number of surface samples per object for D_pen.", ge=16, le=10_000
    )


class SemanticOptions(Options):
    """Options of S_sem, the term that scores how well a candidate agrees with the photograph."""

    scorer: Literal["geometric", "mllm"] = option(
        "geometric",
        "geometric: S_sem of every candidate is computed from the parsed boxes and depths. mllm: "
        "the critic scores rendered images of the best candidates while physics runs; this "
        "requires a photograph.",
        difference=PaperDifference(
            "mllm",
            "One call per candidate is slow and expensive; the geometric score costs nothing.",
        ),
    )
    top: int = option(
        8,
        "Number of candidates per iteration that the model scores. The others have the geometric "
        "score plus the mean difference of the model's scores.",
        ge=1,
        difference=PaperDifference(
            256, "The model scores only the best candidates of an iteration."
        ),
    )
    timeout_s: float = option(
        90.0,
        "Time after a request until which an iteration waits for a score. A later score does not "
        "count.",
        unit="s",
        ge=0,
    )


class SettleOptions(Options):
    """Options of settling under guidance, by springs to the placed poses that fade over time."""

    enabled: bool = option(
        True,
        "Settle the composed scene and every candidate under guidance, and score, check and export "
        "the settled poses. If false, the placed poses are used.",
        difference=PaperDifference(
            False,
            "Some objects lean, roll or lie in a container. They settle at poses that no "
            "layout can express and only simulation finds.",
        ),
    )
    duration_s: float = option(2.0, "Simulated time.", unit="s", gt=0, le=20)
    rate: float = option(
        12.0,
        "Natural frequency of the critically damped springs on position and rotation. The springs "
        "scale with the mass and inertia of each object, which sags by g / rate^2.",
        unit="1/s",
        ge=0,
        le=50,
    )
    fade_s: float = option(
        1.4, "Time in which the springs fade linearly to zero.", unit="s", gt=0, le=20
    )


class RefineOptions(Options):
    """Options of Step 5, scene refinement: search, rewards, rollouts and the final check."""

    optimizer: str = option(
        "cem",
        'Optimizer: cem, random, or the import path "package.module:function" of a function that '
        "builds an optimizer from the scene and the options `cem`.",
    )
    cem: CEMOptions = CEMOptions()
    reward: RewardOptions = RewardOptions()
    rollout: RolloutOptions = RolloutOptions()
    semantic: SemanticOptions = SemanticOptions()
    check_duration_s: float = option(
        2.0, "Simulated time of the final check.", unit="s", ge=0.01, le=100
    )
    max_drift_m: float = option(
        0.01,
        "Maximum displacement in a valid candidate and in the final check; the unit of D_drift.",
        unit="m",
        gt=0,
    )
    max_tilt_deg: float = option(
        5.0,
        "Maximum rotation in a valid candidate and in the final check; the unit of D_drift.",
        unit="deg",
        gt=0,
    )
    max_depth_m: float = option(
        0.001,
        "Maximum penetration depth in a valid candidate and in the final check.",
        unit="m",
        gt=0,
    )
    settle: SettleOptions = SettleOptions()
    finalists: int = option(
        4,
        "Maximum number of candidates whose final scenes are checked, best first.",
        ge=1,
        difference=PaperDifference(
            1,
            "The best candidate may fail the final check, which is finer than the rollouts, while "
            "the next candidate passes.",
        ),
    )
