"""Options of Step 5: search, rewards, rollouts, semantic scores and the final check.

Options are host, traced or static; `tests/sweeps/test_grouping.py` compares the declarations with
the search's actual compilations.
"""

from typing import Literal

from ..engines import ENGINES_HELP, EngineChoice
from ..options import Options, PaperDifference, option, static, traced

_PROGRAM, _SHAPE = "changes the program", "sets array shapes"
_SHARED = "is shared by all candidates of a rollout"
_EARLY_STOP = "sets the early-stop rule"
"""Reason of options that are traced in the reward, but static if `rollout.early_stop` is on."""


class CEMOptions(Options):
    """The Cross-Entropy Method (Algorithm 1 and Appendix B of the paper)."""

    population: int = static(_SHAPE, 64, "Candidates per iteration.", ge=2, le=100_000)
    iterations: int = option(8, "Maximum number of iterations.", ge=1, le=10_000)
    elite_ratio: float = static(
        _SHAPE,
        0.125,
        "Fraction of candidates that are elites: K = elite_ratio * population.",
        gt=0,
        le=1,
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
    photo_sigma: bool = option(
        False,
        "Initial standard deviations of aligned objects are no larger than what the photograph "
        "leaves, the covariance of the alignment.",
    )
    hold_resting: bool = option(
        True,
        "Hold objects that rest where they should in the initial layout, so that only the others, "
        "and what they support, move. In a sweep, they are fixed only if all runs start at the "
        "composed scene; otherwise they are free, but not perturbed. With custom reward terms, "
        "scores by a model, or another optimizer, all objects move.",
        difference=PaperDifference(
            False, "Moving an object that already rests where it should can only make it worse."
        ),
    )
    widest: float = traced(
        8.0,
        "Limit of the factor on an object's deviations. The factor doubles in every iteration in "
        "which the object rests in no candidate; for yaw and scale it is at most 1. The search "
        "ends if the object rests in no candidate at the limit. 1 disables the rule with `credit: "
        "scene`.",
        ge=1,
        le=1000,
        difference=PaperDifference(
            1.0, "An object next to its support is never drawn onto it from too narrow a Gaussian."
        ),
    )
    sigma_floor: float = traced(
        0.02,
        "Minimum standard deviation, as a fraction of the initial one.",
        ge=0,
        difference=PaperDifference(
            0.0, "Elites that agree in one variable would freeze it for the rest of the search."
        ),
    )
    smoothing: float = traced(
        0.0,
        "Weight of the previous mean and standard deviation in the update; 0 is Algorithm 1.",
        ge=0,
        lt=1,
    )
    zero_candidate: bool = static(
        _PROGRAM,
        True,
        "Include the mean as a candidate; in the first iteration it is the initial layout.",
        difference=PaperDifference(False, "A valid initial layout should be accepted immediately."),
    )
    credit: Literal["scene", "object"] = static(
        _PROGRAM,
        "object",
        "Reward that selects elites until a candidate is valid. scene: the reward of the scene. "
        "object: for each object, that of the terms that involve it, among the candidates in which "
        "it rests.",
        difference=PaperDifference(
            "scene",
            "In a scene of many objects hardly any candidate is good for all of them.",
        ),
    )
    stop_by: Literal["best", "elites"] = traced(
        "best",
        "Quantity whose gain decides when the search stops. best: the best valid candidate so far. "
        "elites: the mean absolute reward of the elites, as in Algorithm 1.",
        difference=PaperDifference(
            "elites", "The result is the best candidate; the mean of the elites does not matter."
        ),
    )
    stop_gain: float = traced(
        0.005, "Gain in absolute reward below which an iteration counts towards `patience`.", ge=0
    )
    patience: int = traced(
        1, "Consecutive iterations below `stop_gain` that end the search; 1 is Algorithm 1.", ge=1
    )


class RewardOptions(Options):
    """R(z) = w_sem S_sem - w_pen D_pen - w_drift D_drift (Section 3.3 of the paper)."""

    w_sem: float = traced(1.0, "Weight of S_sem, the agreement with the photograph.", ge=0)
    w_pen: float = traced(1.0, "Weight of D_pen, the penetration.", ge=0)
    w_drift: float = traced(1.0, "Weight of D_drift, the displacement in the rollout.", ge=0)
    w_prior: float = traced(
        0.3,
        "Weight of the prior, the distance to the initial layout: the mean of (z / sigma)^2 over "
        "objects and their four variables, where sigma is the initial standard deviation.",
        ge=0,
        difference=PaperDifference(
            0.0,
            "Otherwise unconstrained variables drift, and objects shrink to reduce overlap.",
        ),
    )
    normalisation: Literal["iteration", "fixed"] = static(
        _PROGRAM,
        "fixed",
        "Normalization of D_pen and D_drift. iteration: over the candidates of the iteration. "
        "fixed: by the caps below.",
        difference=PaperDifference(
            "iteration", "Rewards are comparable between iterations and bounded before physics."
        ),
    )
    d_pen_cap_m: float = traced(0.005, "Upper clip of D_pen.", unit="m", gt=0)
    d_drift_cap: float = traced(
        3.0,
        "Upper clip of D_drift: 3 is 3 cm or 15 degrees. A small cap keeps the difference between "
        "valid and nearly valid candidates large compared with that between two bad ones.",
        unit="drift scales",
        reason=_EARLY_STOP,
        gt=0,
    )
    drift_free: float = traced(
        0.1,
        "Drift of an object without a penalty: 0.1 is 1 mm or 0.5 degrees, by which stable "
        "objects settle.",
        unit="drift scales",
        ge=0,
        difference=PaperDifference(
            0.0,
            "All objects settle slightly, which would penalize valid candidates.",
        ),
    )
    pen_scale_m: float = traced(
        0.001,
        "Scale of D_pen in the absolute reward, which compares iterations.",
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
        "Further reward terms and their weights: custom terms by import path "
        '"package.module:function", built-in terms by name. Weights are traced; other terms '
        "compile another program.",
    )


class RolloutOptions(Options):
    """Free-fall rollouts of candidate layouts."""

    engine: EngineChoice = static(_PROGRAM, "auto", f"{ENGINES_HELP}.")
    duration_s: float = static(
        _SHARED,
        1.0,
        "Simulated time; 0 evaluates candidates without simulation, and only the final check tests "
        "stability.",
        unit="s",
        ge=0,
        le=100,
    )
    timestep_s: float = static(
        "is part of the compiled scene",
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
        "End a candidate's rollout once it has settled, stays beyond the stability thresholds, "
        "or has drifted beyond the cap.",
        difference=PaperDifference(
            False, "Most candidates settle or fail long before the end of the rollout."
        ),
    )
    samples_per_object: int = static(
        _SHAPE, 256, "Surface samples per object for D_pen.", ge=16, le=10_000
    )


class SemanticOptions(Options):
    """S_sem, the agreement of candidates with the photograph."""

    scorer: Literal["geometric", "mllm"] = option(
        "geometric",
        "geometric: computed from the parsed boxes and depths, for every candidate. mllm: the "
        "critic scores rendered images of the best candidates while physics runs; requires a "
        "photograph.",
        difference=PaperDifference(
            "mllm",
            "One call per candidate is slow and expensive; the geometric score costs nothing.",
        ),
    )
    top: int = option(
        8,
        "Candidates per iteration that the model scores; a surrogate scores the others.",
        ge=1,
        difference=PaperDifference(
            256, "The model scores only the best candidates of an iteration."
        ),
    )
    wait: Literal["all", "bounded", "none"] = option(
        "all",
        "Scores to wait for before selecting elites: all requested ones, those that are `late` "
        "iterations old (bounded), or none.",
    )
    late: int = option(
        1, "With `wait: bounded`, iterations by which a score may be late; 0 is `wait: all`.", ge=0
    )
    picture_px: int = option(
        320,
        "Width of a candidate's rendered image; rendering competes with physics for the CPU.",
        unit="px",
        ge=64,
    )
    shadows: bool = option(
        False,
        "Render shadows and texture instead of flat colors with outlines, at five times the cost.",
    )
    timeout_s: float = option(
        90.0, "Time limit for a score with all its retries, once sent.", unit="s", gt=0
    )
    give_up_after: int = option(
        5, "Consecutive failed scores after which no more are requested.", ge=1
    )
    max_cost_usd: float | None = option(
        None,
        "Cost of scores after which no more are requested; those in flight still arrive. "
        "`mllm.max_cost_usd` is the hard limit of the run. null means no limit.",
        unit="USD",
        gt=0,
    )


class SettleOptions(Options):
    """Settling under guidance: springs hold objects near their placed poses, and fade."""

    enabled: bool = static(
        _SHARED,
        True,
        "Settle the composed scene and every candidate under guidance, and judge and export them "
        "at rest. Otherwise candidates are judged where their layouts place them.",
        difference=PaperDifference(
            False,
            "Objects that lean, lie in a container or roll rest at a pose that no layout can "
            "express; only simulation finds it.",
        ),
    )
    duration_s: float = static(_SHARED, 2.0, "Simulated time.", unit="s", gt=0, le=20)
    rate: float = static(
        _SHARED,
        12.0,
        "Natural frequency of the critically damped springs on position and rotation, in units of "
        "each object's mass and inertia; an object sags by g / rate^2.",
        unit="1/s",
        ge=0,
        le=50,
    )
    fade_s: float = static(
        _SHARED, 1.4, "Time in which the springs fade linearly to zero.", unit="s", gt=0, le=20
    )
    max_speed_m_s: float = static(
        _SHARED, 2.0, "Limit of an object's speed while it settles.", unit="m/s", gt=0, le=100
    )


class RefineOptions(Options):
    """Step 5, scene refinement: search, rewards, rollouts and the final check."""

    optimizer: str = static(
        _PROGRAM,
        "cem",
        "cem, random, cma_es or evosax:STRATEGY such as evosax:SNES (extra `baselines`), or the "
        'import path "package.module:function" of a function that builds an optimizer from the '
        "scene and `cem`.",
    )
    strategy: dict[str, float] = static(
        _PROGRAM,
        {},
        "Parameters of the strategy evosax:STRATEGY by their names in evosax, such as `std_init`, "
        "in units of the initial deviations; `learning_rate` is that of Adam where it has a "
        "gradient optimizer. `restart_spread` starts a strategy of a distribution again at the "
        "initial layout where the absolute rewards of a population differ by less.",
    )
    cem: CEMOptions = CEMOptions()
    reward: RewardOptions = RewardOptions()
    rollout: RolloutOptions = RolloutOptions()
    semantic: SemanticOptions = SemanticOptions()
    check_duration_s: float = option(
        2.0, "Simulated time of the final check.", unit="s", ge=0.01, le=100
    )
    check_timestep_s: float = option(
        0.002, "Time step of the final check.", unit="s", ge=1e-4, le=0.1
    )
    max_drift_m: float = option(0.01, "Maximum displacement in the final check.", unit="m", gt=0)
    max_tilt_deg: float = option(5.0, "Maximum rotation in the final check.", unit="deg", gt=0)
    max_depth_m: float = traced(
        0.001, "Maximum penetration of a valid candidate and in the final check.", unit="m", gt=0
    )
    settle: SettleOptions = SettleOptions()
    merit: Literal["fidelity", "absolute"] = traced(
        "fidelity",
        "Value by which valid candidates compete to be the result, and by whose gain `cem.stop_by: "
        "best` stops; all others rank behind them by the absolute reward. fidelity: the absolute "
        "reward without D_pen and D_drift, less a cost for displacement by settling. absolute: the "
        "absolute reward.",
        difference=PaperDifference(
            "absolute",
            "Within the bounds of a valid candidate, penetration and drift hardly differ from what "
            "settling leaves.",
        ),
    )
    finalists: int = option(
        4,
        "Number of best candidates whose final scenes may be checked.",
        ge=1,
        difference=PaperDifference(
            1,
            "The best candidate of the coarse rollouts may fail the finer check while the next "
            "passes.",
        ),
    )
