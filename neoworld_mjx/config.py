"""Every option of the package, in one validated tree that is read from and written to YAML.

A configuration file states only what differs from the defaults here. Units are in the names or in
the field's description; unknown keys are errors that name the key and its valid neighbours.
"""

import hashlib
import json
import re
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from .errors import ConfigError, choices

Role = Literal["reasoner", "programmer", "critic"]
EngineName = Literal["auto", "mjx", "warp", "native"]

_KEY_HEADER = re.compile(r"authorization|key|token|secret|cookie", re.IGNORECASE)
_UNSHOWN = ("headers", "base_url")
"""Options whose wrong values are not shown, as they may hold keys."""


class Options(BaseModel):
    """Base of all option groups: frozen, and closed against unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class RoleOptions(Options):
    """Which model plays a role of Section 3.2 of the paper."""

    model: str = "claude-sonnet-5-5"
    max_tokens: int = Field(default=16384, ge=256)
    """Longest answer, in tokens; with models that think first their thinking is part of it."""


class MLLMOptions(Options):
    """How multimodal models are asked."""

    model_config = ConfigDict(hide_input_in_errors=True)

    reasoner: RoleOptions = RoleOptions()
    programmer: RoleOptions = RoleOptions(max_tokens=32768)
    critic: RoleOptions = RoleOptions()
    base_url: str | None = None
    """A server that speaks the provider's API, such as vLLM or Ollama."""
    headers: dict[str, str] = {}
    """Sent with every call. Keys are named, not written: `{"x-api-key": "${MY_KEY}"}`."""
    timeout_s: float = Field(default=120.0, gt=0)
    """The longest silence of a server; a call as a whole may take ten times as long."""
    retries: int = Field(default=4, ge=0)
    concurrency: int = Field(default=8, ge=1)
    validation_rounds: int = Field(default=3, ge=1)
    """How often an answer that breaks the schema is sent back with its error."""
    max_cost_usd: float | None = Field(default=None, gt=0)
    prices: Path | None = None
    """YAML of prices in USD per million tokens; None takes the table in the package."""

    @field_validator("headers", "base_url")
    @classmethod
    def _keep_keys_out(cls, value: Any) -> Any:
        """Refuse keys, as a configuration is written into every run."""
        for name, text in value.items() if isinstance(value, dict) else ():
            if _KEY_HEADER.search(name) and "${" not in text:
                raise ValueError(f"{name} would be written into run.json: give it as ${{VARIABLE}}")
        if isinstance(value, str) and re.search(r"://[^/]*@|[?&][^=]*(key|token)=", value, re.I):
            raise ValueError("holds a key, which would be written into run.json: use headers")
        return value


class ParseOptions(Options):
    """Step 1, scene parsing."""

    critic_rounds: int = Field(default=1, ge=0)
    max_side_px: int = Field(default=1568, ge=64)
    """Longer side of the picture that the model is shown."""
    fit: bool = True
    """Fit camera and 3D boxes to the 2D boxes by least squares, where that brings them closer."""


class ProgramOptions(Options):
    """Step 2, procedural asset programming."""

    debug_rounds: int = Field(default=1, ge=0)
    critic_rounds: int = Field(default=1, ge=0)
    geometry_critic: bool = True
    """Show the critic the object at rest."""
    articulation_critic: bool = True
    """Show the critic the object opened, where it has joints that move."""
    accept_score: float = Field(default=8.0, ge=0, le=10)
    """Critic's score from which no further round is asked for."""
    sandbox: Literal["monty", "cpython"] = "monty"
    """cpython runs the text in this very process, without any wall: for one's own programs only."""
    type_check: bool = True
    timeout_s: float = Field(default=1.0, gt=0)
    """Of the program's own code, and again as much for the shapes that it asks for."""
    memory_mib: int = Field(default=64, ge=8)
    max_recursion: int = Field(default=200, ge=10)
    max_calls: int = Field(default=5000, ge=10)
    """Calls of the SDK."""
    max_output_bytes: int = Field(default=20_000, ge=0)
    """Of what the program prints."""
    max_text_bytes: int = Field(default=200_000, ge=100)
    max_parts: int = Field(default=300, ge=1)
    max_geoms: int = Field(default=3000, ge=1)
    max_pieces: int = Field(default=4000, ge=1)
    """Convex pieces of the whole object."""
    workers: int = Field(default=2, ge=1)
    """Sandbox processes kept for programs that run at once."""
    touch_gap_m: float = Field(default=0.002, ge=0)
    """Farthest that a part may stay away from what it is attached to."""
    max_depth_m: float = Field(default=0.001, gt=0)
    """Deepest that two parts of an object may enter each other."""
    sweep_steps: int = Field(default=9, ge=2)
    """Positions tried over each joint's range."""
    sweep_combinations: int = Field(default=16, ge=0)
    """Positions tried with all joints moved at once."""
    check_timeout_s: float = Field(default=1.0, gt=0)


class VerifyOptions(Options):
    """Step 3, object-level physics."""

    duration_s: float = Field(default=2.0, gt=0)
    timestep_s: float = Field(default=0.002, gt=0)
    drop_height_m: float = Field(default=0.005, ge=0)
    impulse_ns_per_kg: float = Field(default=0.3, ge=0)
    """Force perturbation: impulse per kilogram, that is the change of speed in m/s."""
    push_duration_s: float = Field(default=0.1, gt=0)
    max_drift_m: float = Field(default=0.01, gt=0)
    max_tilt_deg: float = Field(default=5.0, gt=0)
    max_depth_m: float = Field(default=0.001, gt=0)
    max_rest_speed: float = Field(default=0.01, gt=0)
    """Speed [m/s] at the end of the free fall."""
    max_energy_gain: float = Field(default=0.02, gt=0)
    """Rise of mechanical energy with no force acting, over the object's weight times its extent."""
    max_overshoot: float = Field(default=0.05, gt=0)
    """Travel beyond a joint limit, over the joint's range."""
    joint_push_s: float = Field(default=0.5, gt=0)
    """Time in which a free joint is pushed across its range."""
    min_mobility: float = Field(default=0.9, gt=0, le=1)
    """What a joint covers when it is driven both ways, over its range."""
    hand_force_n: float = Field(default=100.0, gt=0)
    """Most that drives a joint, at its far end; what weighs more gets half its weight on top."""
    high_drop_m: float = Field(default=0.02, ge=0)
    """Height of the second, higher fall."""
    drop_tilt_deg: float = Field(default=3.0, ge=0, lt=45)
    """Tilt of the falls that start tilted."""
    min_loss: float = Field(default=0.05, ge=0, lt=1)
    """Share of its speed that a joint left to itself must lose in half a second."""
    min_slide_deg: float = Field(default=5.0, ge=0)
    max_slide_deg: float = Field(default=60.0, gt=0, le=65)
    """Slopes between which an object must begin to slide."""
    touch_gap_m: float = Field(default=0.004, ge=0)
    """Most air between a part and what it hangs on; 1 % of the object's size where that is more."""
    max_pivot_off: float = Field(default=0.05, ge=0)
    """How far a hinge may pass beside the parts it joins, over the child's diagonal."""
    sweep_steps: int = Field(default=13, ge=3)
    """Positions of each joint at which the depth between parts is measured."""
    sweep_combinations: int = Field(default=12, ge=0)
    """Positions of all joints at once, besides."""
    rounds: int = Field(default=6, ge=0)
    """How many repairs of an object may be tried; 0 leaves objects as they are."""
    critic: bool = False
    """Whether the critic looks at key frames of what failed or only just passed, and its edits of what
    failed are tried too."""


class ComposeOptions(Options):
    """Step 4, scene composition."""

    gap_m: float = Field(default=1e-4, ge=0)
    """Clearance left between a child and the surface it is snapped onto."""


class CEMOptions(Options):
    """Step 5, the Cross-Entropy Method (Algorithm 1 and Appendix B of the paper)."""

    population: int = Field(default=256, ge=2)
    iterations: int = Field(default=8, ge=1)
    elite_ratio: float = Field(default=0.05, gt=0, le=1)
    sigma_xy: float = Field(default=0.05, ge=0)
    """Of the object's horizontal bounding-box diagonal."""
    sigma_yaw_deg: float = Field(default=15.0, ge=0)
    sigma_log_scale: float = Field(default=0.1, ge=0)
    sigma_floor: float = Field(default=0.02, ge=0)
    """Smallest standard deviation, as a fraction of the initial one."""
    smoothing: float = Field(default=0.0, ge=0, lt=1)
    """Weight of the old mean and deviation in the update; 0 is Algorithm 1."""
    zero_candidate: bool = True
    """Always try the mean itself as a candidate; at first that is the composed layout."""
    first: int = Field(default=32, ge=0)
    """Population of the first iteration, where it is the smaller one: it mostly finds out where the
    start fails; 0 is that of the others."""
    credit: Literal["auto", "scene", "object", "island"] = "auto"
    """Whose reward chooses elites: the scene's, or for each object that of what it takes part in, or of
    all that it may come to touch. auto: the scene's from the first valid candidate on, by object
    before."""
    prune: bool = True
    """Do not roll out what cannot become an elite; changes no elite. Only with `normalisation: fixed`,
    and neither with a user's own terms nor with scores by a model, which have no known bound."""
    batch: int = Field(default=16, ge=1)
    """Candidates rolled out at once while pruning."""
    stop_gain: float = Field(default=0.005, ge=0)
    """Stop when the elites' mean absolute reward gains less than this in an iteration."""
    patience: int = Field(default=2, ge=1)
    """How many iterations in a row must gain less; 1 is Algorithm 1."""


class RewardOptions(Options):
    """R(z) = w_sem S_sem - w_pen D_pen - w_drift D_drift (Section 3.3)."""

    w_sem: float = Field(default=1.0, ge=0)
    w_pen: float = Field(default=1.0, ge=0)
    w_drift: float = Field(default=1.0, ge=0)
    w_prior: float = Field(default=0.3, ge=0)
    """Weight of the prior that holds layouts near the composed one, and sizes near the parsed ones:
    the mean of (z / sigma)^2 over objects and their four numbers, sigma being the initial one."""
    normalisation: Literal["iteration", "fixed"] = "fixed"
    d_pen_cap_m: float = Field(default=0.005, gt=0)
    d_drift_cap: float = Field(default=3.0, gt=0)
    """In units of the drift scales below: 3 is 3 cm or 15 degrees. A small cap keeps the difference
    between a valid candidate and one that just fails from drowning in that between two bad ones."""
    drift_free: float = Field(default=0.1, ge=0)
    """Drift of an object that costs nothing, in units of the drift scales: 0.1 is the millimetre and half
    degree that things settle by when they are set down."""
    pen_scale_m: float = Field(default=0.001, gt=0)
    drift_scale_m: float = Field(default=0.01, gt=0)
    tilt_scale_deg: float = Field(default=5.0, gt=0)
    terms: dict[str, float] = {}
    """A user's own reward terms: import path "package.module:function" to weight."""


class RolloutOptions(Options):
    """Free-fall rollouts of candidate layouts."""

    engine: EngineName = "auto"
    duration_s: float = Field(default=1.0, ge=0)
    """0 judges candidates without simulation: whether they stay where they are is told by the final
    check alone."""
    timestep_s: float = Field(default=0.004, gt=0)
    record_every_s: float = Field(default=0.1, gt=0)
    early_stop: bool = True
    """End a candidate's rollout once it has settled, or has drifted past the cap."""
    samples_per_object: int = Field(default=256, ge=16)
    """Surface samples of an object for D_pen."""


class DescentOptions(Options):
    """Adam on the differentiable terms, before physics."""

    warm_steps: int = Field(default=100, ge=0)
    """Steps that the start of the search takes towards the photograph's boxes and out of
    interpenetration; 0 starts at the composed scene."""
    project: Literal["never", "needed", "always"] = "needed"
    """Move candidates out of interpenetration: none, all, or those of iterations before which none was
    valid."""
    project_steps: int = Field(default=6, ge=1)
    """Steps that a candidate takes then."""
    rate: float = Field(default=0.2, gt=0)
    """Length of a step, in initial standard deviations."""
    samples: int = Field(default=64, ge=8)
    """Surface samples of an object that a step looks at."""


class SemanticOptions(Options):
    """S_sem of Step 5: who scores how candidates agree with the photograph."""

    scorer: Literal["geometric", "mllm"] = "geometric"
    """mllm shows the critic a picture of the best candidates, while physics runs; needs a photo."""
    top: int = Field(default=8, ge=1)
    """How many candidates of an iteration are shown to the model; the others are estimated."""
    wait: Literal["all", "bounded", "none"] = "all"
    """Before elites are taken: for every score asked for, for those that are `late` iterations old,
    or for none."""
    late: int = Field(default=1, ge=0)
    """With `bounded`: how many iterations late a score may come; 0 is `all`."""
    picture_px: int = Field(default=320, ge=64)
    """Width of a candidate's picture; drawing it takes time from physics on the same CPU."""
    shadows: bool = False
    """Draw shadows and grain instead of flat colours with outlines, at five times the cost."""
    timeout_s: float = Field(default=90.0, gt=0)
    """The longest that one score may take with all its retries, once sent."""
    give_up_after: int = Field(default=5, ge=1)
    """Scores that fail one after the other until no more are asked for."""
    max_cost_usd: float | None = Field(default=None, gt=0)
    """No more scores are asked for once they have cost so much; those under way still come.
    `mllm.max_cost_usd` is the cap that no call may exceed."""


class RefineOptions(Options):
    """Step 5 as a whole: search, rewards, rollouts and the final check."""

    cem: CEMOptions = CEMOptions()
    descent: DescentOptions = DescentOptions()
    reward: RewardOptions = RewardOptions()
    rollout: RolloutOptions = RolloutOptions()
    semantic: SemanticOptions = SemanticOptions()
    check_duration_s: float = Field(default=2.0, gt=0)
    check_timestep_s: float = Field(default=0.002, gt=0)
    max_drift_m: float = Field(default=0.01, gt=0)
    max_tilt_deg: float = Field(default=5.0, gt=0)
    max_depth_m: float = Field(default=0.001, gt=0)
    finalists: int = Field(default=16, ge=1)
    """How many of the best candidates may be tried in the final check."""


class RenderOptions(Options):
    """Ray-cast pictures."""

    width: int = Field(default=480, ge=16)
    supersample: int = Field(default=2, ge=1, le=4)


class Config(Options):
    """All options of a run."""

    seed: int = Field(default=0, ge=0)
    provider: str = "auto"
    mllm: MLLMOptions = MLLMOptions()
    parse: ParseOptions = ParseOptions()
    program: ProgramOptions = ProgramOptions()
    verify: VerifyOptions = VerifyOptions()
    compose: ComposeOptions = ComposeOptions()
    refine: RefineOptions = RefineOptions()
    render: RenderOptions = RenderOptions()

    def fingerprint(self) -> str:
        """Return 16 hex digits that change whenever any option changes."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def load_config(path: Path | None = None, overrides: dict[str, Any] | None = None) -> Config:
    """Read a YAML file of options and lay overrides over it.

    Args:
        path: the file; None means the defaults alone.
        overrides: a nested mapping that wins over the file, such as {"seed": 3}.

    Raises:
        ConfigError: the file is missing or no YAML mapping, or a key or value is wrong; the message
            names the file, the key's full path and the valid keys.
    """
    data: dict[str, Any] = {}
    if path is not None:
        data = _read_yaml(path)
    data = merged(data, overrides or {})
    try:
        return Config.model_validate(data)
    except ValidationError as error:
        where = str(path) if path is not None else "options"
        raise ConfigError(f"{where}: {describe(error, Config)}") from None


def describe(error: ValidationError, model: type[BaseModel]) -> str:
    """Phrase a validation error in one line a person can act on."""
    lines = []
    for item in error.errors():
        where = ".".join(str(step) for step in item["loc"]) or "(root)"
        if item["type"] == "extra_forbidden":
            keys = _keys_at(model, item["loc"][:-1])
            lines.append(f"unknown key {where}: {choices(str(item['loc'][-1]), keys)}")
        elif any(name in item["loc"] for name in _UNSHOWN):
            lines.append(f"{where}: {item['msg']}")
        else:
            shown = repr(item["input"])
            shown = shown if len(shown) <= 80 else shown[:77] + "..."
            lines.append(f"{where}: {item['msg']}, got {shown}")
    return "; ".join(lines)


def _keys_at(model: type[BaseModel], path: tuple[Any, ...]) -> list[str]:
    for step in path:
        field = model.model_fields.get(str(step))
        inner = field.annotation if field is not None else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return []
        model = inner
    return sorted(model.model_fields)


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        data = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read config {path}: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"config {path} is not valid YAML: {error}") from None
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(f"config {path} must be a mapping of options, got {type(data).__name__}")
    return data


def merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Lay one nested mapping over another."""
    result = dict(base)
    for key, value in over.items():
        old = result.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            value = merged(old, value)
        result[key] = value
    return result
