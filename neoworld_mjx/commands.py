"""The commands of `neoworld`: each takes its arguments and returns what is to be printed.

Whatever is heavy is imported inside the functions, so that `--help` is quick.
"""

import os
from typing import TYPE_CHECKING, Any

from .arguments import (
    Ablate,
    Bench,
    BenchChart,
    Build,
    Check,
    Configured,
    Doctor,
    Reconstruct,
    Refine,
    Render,
    Report,
    Sweep,
)
from .errors import ConfigError, NeoWorldError, RunError, SpecError

if TYPE_CHECKING:
    from .config import Config
    from .program import Built

Answer = dict[str, Any]
"""Its entry "passed" decides the exit code."""


def reconstruct(command: Reconstruct) -> Answer:
    """Run the five steps."""
    from .cache import keep_compilations
    from .pipeline import reconstruct as steps

    config = _config(command, command.provider, command.engine, command.seed)
    keep_compilations()
    result = steps(
        command.photo,
        command.out,
        config,
        until=command.until,
        resume=command.resume,
        start=command.start,
        overwrite=command.overwrite,
        record=command.record,
        mailbox=command.mailbox,
        tapes=command.tape,
    )
    return result.summary()


def refine(command: Refine) -> Answer:
    """Refine the composed scene of a run again."""
    from .cache import keep_compilations
    from .pipeline import refine_again

    keep_compilations()
    over = {
        "seed": command.seed,
        "refine": None if command.engine is None else {"rollout": {"engine": command.engine}},
    }
    config = None
    if command.config is not None or command.set:
        config = _config(command, None, command.engine, command.seed)
    over = {key: value for key, value in over.items() if value is not None}
    return refine_again(command.folder, config, over).summary()


def check(command: Check) -> Answer:
    """Measure a scene, or try an object by itself and say what is wrong with it."""
    config = _config(command)
    suffix = command.target.suffix.lower()
    if suffix in (".usd", ".usda", ".usdc", ".usdz"):
        raise SpecError(f"{command.target}: USD is not read yet; check the URDF or MJCF beside it")
    if suffix in (".py", ".urdf", ".xml", ".mjcf"):
        from .verify.checking import check_object

        return check_object(
            command.target,
            config,
            fixed_base=command.fixed_base,
            mend=command.repair,
            out=command.out,
        )
    if command.repair or command.fixed_base or command.out is not None:
        raise SpecError(f"{command.target}: a scene is measured as it is; refine mends scenes")
    from .measure.stability import scene_measure
    from .spec import read_scene

    limits = config.refine
    found = scene_measure(
        read_scene(command.target),
        duration=limits.check_duration_s,
        timestep=limits.check_timestep_s,
        max_depth=limits.max_depth_m,
        max_drift=limits.max_drift_m,
        max_tilt=limits.max_tilt_deg,
    )
    checks = [
        ("max_depth_m", found.max_depth_m, limits.max_depth_m, not found.s_pen),
        ("max_drift_m", found.max_drift_m, limits.max_drift_m, found.s_stab),
        ("max_tilt_deg", found.max_tilt_deg, limits.max_tilt_deg, found.s_stab),
    ]
    return {
        "target": str(command.target),
        "passed": not found.s_pen and found.s_stab is not False,
        "checks": [
            {"name": name, "value": value, "threshold": limit, "passed": passed}
            for name, value, limit, passed in checks
        ],
        **found.model_dump(),
    }


def build(command: Build) -> Answer:
    """Build a program and write its object in every format."""
    from .program.watch import watch, write_built
    from .verify.patch import overlay_path
    from .verify.patched import build_patched, read_program

    out = command.out
    if out.exists() and not out.is_dir():
        raise RunError(f"{out} is a file; name a folder")
    if out.is_dir() and any(out.iterdir()) and not command.overwrite:
        raise RunError(f"{out} is not empty: name a new folder, or use --overwrite")
    options = _config(command).program
    if command.watch:
        read_program(command.program)  # What is not there at all is told at once.
        beside = (overlay_path(command.program),)
        make = lambda program: build_patched(program, options)
        return {"folder": str(out), "builds": watch(command.program, out, make, beside)}
    made = build_patched(command.program, options)
    built = made.built
    answer: Answer = {"passed": built.ok, "signals": _signals(built)}
    if built.spec is None or not built.ok:
        return answer
    if made.patch is not None:
        answer["overlay"] = {"changes": list(made.patch.changes()), "stale": list(made.stale)}
    write_built(made, out)
    return {"object": built.spec.name, "folder": str(out), **answer}


def render(command: Render) -> Answer:
    """Ray-cast a scene with its own camera."""
    from .files import write_atomic
    from .render import render_scene, to_png
    from .spec import read_scene

    options = _config(command).render
    scene = read_scene(command.target)
    home = command.target if command.target.is_dir() else command.target.parent
    out = command.out or home / "render.png"
    picture = render_scene(
        scene, width=command.width or options.width, supersample=options.supersample
    )
    try:
        write_atomic(out, to_png(picture))
    except OSError as error:
        raise RunError(f"cannot write {out}: {error.strerror}") from None
    return {"picture": str(out), "size": [picture.color.shape[1], picture.color.shape[0]]}


def report(command: Report) -> Answer:
    """Write the report of a run."""
    from .view.report import write_report

    return {"report": str(write_report(command.folder))}


def sweep(command: Sweep | Ablate) -> Answer:
    """Run a sweep or an ablation."""
    from .bench.named import named
    from .cache import keep_compilations
    from .sweeps import Case, ablate, answer, sweep

    keep_compilations()
    sources = {kind: lambda name, make=make: Case(**make(name)) for kind, make in named().items()}
    search = ablate if isinstance(command, Ablate) else sweep
    found = search(
        command.plan,
        command.out,
        sources=sources,
        resume=command.resume,
        overwrite=command.overwrite,
    )
    return answer(found, command.out)


def doctor(_: Doctor) -> Answer:
    """Look at this machine."""
    import platform

    import jax

    from .cache import cache_folder
    from .engines import ENGINES
    from .mllm.provider import bundled_tapes
    from .run_folder import versions

    kept = cache_folder()
    tapes = sorted(path.name for path in bundled_tapes().glob("*") if path.is_file())
    return {
        "system": platform.platform(),
        "cores": os.cpu_count(),
        "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
        "engines": {name: _engine(name) for name in ENGINES},
        "cache": {"folder": str(kept), "exists": kept.is_dir()},
        "keys": {name: bool(os.environ.get(name)) for name in _KEYS},
        "tapes": tapes,
        "versions": versions(),
    }


def bench(command: Bench) -> Answer:
    """Run a benchmark, or draw its chart."""
    if isinstance(command.inner, BenchChart):
        from .bench.command import chart_answer

        return chart_answer(command.inner)
    return run_suite(command.inner)


def run_suite(command: Any) -> Answer:
    """Run the suite of a command of `arguments.suite_commands`."""
    from .cache import keep_compilations

    keep_compilations()
    function = command.suite.load()
    return function(command, _config(command)) if command.suite.configured else function(command)


_KEYS = ("ANTHROPIC_API_KEY", "OPENAI_API_KEY")
COMMANDS: dict[type, Any] = {
    Reconstruct: reconstruct,
    Refine: refine,
    Check: check,
    Build: build,
    Render: render,
    Report: report,
    Sweep: sweep,
    Ablate: sweep,
    Doctor: doctor,
    Bench: bench,
}


def _signals(built: "Built") -> list[dict[str, Any]]:
    return [{"code": s.code, **s.model_dump(exclude_defaults=True)} for s in built.signals]


def _engine(name: str) -> str:
    from .physics.simulate import open_engine

    try:
        open_engine(name)
    except (NeoWorldError, ImportError) as error:
        return f"not here: {error}"
    return "ready"


def _config(
    command: Configured,
    provider: str | None = None,
    engine: str | None = None,
    seed: int | None = None,
) -> "Config":
    """Lay --set over the file, and the command's own flags over both."""
    import yaml

    from .config import load_config

    over: dict[str, Any] = {}
    for setting in command.set:
        key, equals, value = setting.partition("=")
        if not equals or not key:
            raise ConfigError(f"--set takes KEY=VALUE, such as seed=3, got {setting!r}")
        try:
            _put(over, key, yaml.safe_load(value))
        except yaml.YAMLError:
            raise ConfigError(f"--set {key}: {value!r} is not a YAML value") from None
    for key, value in (("provider", provider), ("refine.rollout.engine", engine), ("seed", seed)):
        if value is not None:
            _put(over, key, value)
    return load_config(command.config, over)


def _put(tree: dict[str, Any], key: str, value: Any) -> None:
    *path, last = key.split(".")
    for name in path:
        inner = tree.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(f"--set {key}: {name} is set to a value already")
        tree = inner
    tree[last] = value
