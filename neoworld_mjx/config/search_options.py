"""Options of Step 5: search, rewards, rollouts, semantic scores and the final check.

Options are host, traced or static; `tests/sweeps/test_grouping.py` compares the declarations with
the search's actual compilations.
"""

from typing import Literal

from ..engines import ENGINES_HELP, EngineChoice
from ..options import Options, PaperDifference, option, static, traced

_PROGRAM, _SHAPE = "changes the program", "sets array shapes"
_EARLY_STOP = "sets the early-stop rule"
"""Reason of options that are traced in the reward, but static if `rollout.early_stop` is on."""


class CEMOptions(Options):
    """The Cross-Entropy Method (Algorithm 1 and Appendix B of the paper)."""

    population: int = static(_SHAPE, 256, "Candidates per iteration.", ge=2, le=100_000)
    iterations: int = option(8, "Maximum number of iterations.", ge=1, le=10_000)
    elite_ratio: float = static(
        _SHAPE,
        0.05,
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
    sigma_agreeing: float = traced(
        0.3,
        "Factor on the initial standard deviations of yaw and scale of objects that neither "
        "overlap nor move in the initial layout, or whose boxes match the photograph's. 1 if "
        "`keep_sound` is false.",
        gt=0,
        le=1,
        difference=PaperDifference(
            1.0,
            "If an object's boxes match, its parsed yaw and scale rarely have larger errors.",
            "heading after the search 1.90 and 2.29 deg, valid 20 and 18 of 20 rendered scenes "
            "(with 0.25; scenes 0 to 19)",
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
    first: int = static(
        _SHAPE,
        32,
        "Population of the first iteration, if smaller than `population`. The first iteration "
        "mainly identifies the objects that fail in the initial layout. 0 means `population`.",
        ge=0,
        difference=PaperDifference(
            0,
            "The first iteration mainly identifies the failing objects; fewer candidates suffice.",
        ),
    )
    credit: Literal["auto", "scene", "object", "island"] = static(
        _PROGRAM,
        "auto",
        "Credit assignment: the reward that selects elites. scene: the reward of the scene. "
        "object: for each object, the terms that involve it. island: the terms of the objects "
        "in its contact component. auto: object until the first valid candidate, then scene.",
        difference=PaperDifference(
            "scene",
            "Until a candidate is valid, each object learns from the candidates in which it "
            "does well.",
        ),
    )
    prune: bool = option(
        True,
        "Skip the rollout of candidates that cannot become elites; the elites do not change. "
        "Requires `normalisation: fixed`, bounded reward terms and no scores by a model.",
        difference=PaperDifference(
            False, "Candidates that cannot become elites need no rollout; the elites do not change."
        ),
    )
    batch: int = option(16, "Candidates per rollout batch while pruning.", ge=1)
    stop_by: Literal["best", "elites"] = option(
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
    patience: int = option(
        2, "Consecutive iterations below `stop_gain` that end the search; 1 is Algorithm 1.", ge=1
    )
    keep_sound: bool = option(
        True,
        "Hold objects fixed that neither overlap nor move in the initial layout and that match "
        "the photograph. If two iterations find no valid candidate they are released, first "
        "those that the moving objects may touch. Objects whose only problem is a mismatch with "
        "the photograph move once the others are valid. With custom reward terms, scores by a "
        "model, or another optimizer, all objects move, as in Algorithm 1.",
        difference=PaperDifference(
            False, "Moving an object that already matches the photograph can only make it worse."
        ),
    )


class DescentOptions(Options):
    """Gradient descent (Adam) on the differentiable terms, before physics."""

    warm_steps: int = static(
        _PROGRAM,
        100,
        "Steps that move the initial layout towards the photograph's boxes and out of "
        "penetration; 0 starts the search at the composed scene.",
        ge=0,
        difference=PaperDifference(
            0, "Gradients of boxes and penetration give directions that random draws have to find."
        ),
    )
    project: Literal["never", "needed", "always"] = static(
        _PROGRAM,
        "needed",
        "Move candidates out of penetration: never, always, or until the first valid candidate "
        "(needed).",
        difference=PaperDifference(
            "never", "Almost every random draw of a crowded scene has interpenetrations."
        ),
    )
    project_steps: int = static(
        _PROGRAM, 6, "Steps that move a candidate out of penetration.", ge=1
    )
    rate: float = static(
        _PROGRAM, 0.2, "Length of a step.", unit="initial standard deviations", gt=0
    )
    samples: int = static(_SHAPE, 64, "Surface samples per object in these steps.", ge=8, le=10_000)


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
        "is shared by all candidates of a rollout",
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


class RefineOptions(Options):
    """Step 5, scene refinement: search, rewards, rollouts and the final check."""

    optimizer: str = static(
        _PROGRAM,
        "cem",
        'cem, cma_es (extra `baselines`), random, or the import path "package.module:function" '
        "of a function that builds an optimizer from the scene and `cem`.",
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
    max_drift_m: float = option(0.01, "Maximum displacement in the final check.", unit="m", gt=0)
    max_tilt_deg: float = option(5.0, "Maximum rotation in the final check.", unit="deg", gt=0)
    max_depth_m: float = traced(
        0.001, "Maximum penetration of a valid candidate and in the final check.", unit="m", gt=0
    )
    settle: Literal["never", "needed", "always"] = option(
        "needed",
        "Let candidates settle before scoring them: never, always, or from the second iteration "
        "on until a candidate is valid (needed). They settle in a damped simulation as long as "
        "a rollout; agreement, penetration and drift are then measured from the settled poses. "
        "Settling counts as drift, and a candidate is invalid if an object settles more than "
        "15 degrees tilted, a quarter of its size to the side, or a tenth of its size and 1 cm "
        "above or below its position. Candidates settle in batches of 64, those that agree best "
        "with the photograph first, until one is valid; after an iteration with a valid "
        "candidate only the first batch settles and the others are dropped.",
        difference=PaperDifference(
            "never",
            "Objects that lean, lie in a container or roll rest at a tilt that no layout can "
            "express; only simulation finds it.",
            "23 of 30 initial scenes valid, 11 without it and without two smaller fixes (n = 30 "
            "scenes)",
        ),
    )
    finalists: int = option(
        16,
        "Number of best candidates that the final check may try.",
        ge=1,
        difference=PaperDifference(
            1,
            "The best candidate of the coarse rollouts may fail the finer check while the next "
            "passes.",
        ),
    )
    returns: int = option(
        8,
        "Number of final checks spent on returning objects that the search moved unnecessarily "
        "to their initial poses, if the scene stays valid and agrees equally well with the "
        "photograph. 0, custom reward terms and scores by a model disable it.",
        ge=0,
        difference=PaperDifference(
            0, "Objects that are correct in the composed scene should not move."
        ),
    )
