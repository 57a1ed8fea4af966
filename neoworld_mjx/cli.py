"""The command `neoworld`: options as dataclasses, one function a command, exit codes 0, 1, 2.

0 is good, 1 says that the scene fails its checks, 2 that the input is wrong. Whatever is heavy is
imported inside the functions, so that `--help` is quick.
"""

import contextlib
import json
import logging
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import DisallowNone, FlagCreatePairsOff, Positional, UseAppendAction, arg, subcommand

from .errors import ConfigError, NeoWorldError, RunError, SpecError

if TYPE_CHECKING:
    from .config import Config

Step = Literal["parse", "program", "verify", "compose", "refine", "export"]
Answer = dict[str, Any]
"""What a command prints; its entry "passed" decides the exit code."""

BAD_INPUT, FAILED, BUG, INTERRUPTED = 2, 1, 70, 130


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of every command."""

    json: bool = False
    """Print one JSON object on stdout, and everything else on stderr."""
    quiet: bool = False
    """Say nothing about progress."""


@dataclass(frozen=True, kw_only=True)
class Configured(Common):
    """Options of the commands that take a configuration."""

    config: Path | None = None
    """YAML of options; only what differs from the defaults."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """One option as KEY=VALUE, such as --set refine.cem.population=64; may be repeated."""


@dataclass(frozen=True, kw_only=True)
class Reconstruct(Configured):
    """Turn a photograph into a scene that simulates."""

    photo: Positional[Path]
    """The photograph."""
    out: Path
    """Run folder to write; a new or empty one, or a run to go on with."""
    provider: str | None = None
    """Who answers: auto, anthropic, openai, replay or mailbox."""
    engine: Literal["auto", "mjx", "warp", "native"] | None = None
    """Physics engine of the refine step."""
    seed: int | None = None
    """Seed of the search."""
    until: Step | None = None
    """Stop after this step."""
    resume: bool = False
    """Go on with the run in --out: keep the finished steps whose inputs have not changed."""
    start: Annotated[Step | None, arg(name="from")] = None
    """Do this step of the run in --out again, and all after it."""
    overwrite: bool = False
    """Replace the run in --out."""
    record: Path | None = None
    """Record the models' answers on this tape, and take those it has from it."""
    mailbox: Path | None = None
    """Folder of requests and answers, for the provider mailbox."""


@dataclass(frozen=True, kw_only=True)
class Check(Configured):
    """Check a scene, or an object's program: every verdict with its number and threshold."""

    target: Positional[Path]
    """A run folder, a scene.json, or a program (.py)."""


@dataclass(frozen=True, kw_only=True)
class Render(Configured):
    """Take a picture of a scene."""

    target: Positional[Path]
    """A run folder or a scene.json."""
    out: Path | None = None
    """PNG file to write; by default render.png beside the scene."""
    width: int | None = None
    """Of the picture, in pixels."""


@dataclass(frozen=True, kw_only=True)
class Report(Common):
    """Write report.html of a run, finished or not."""

    folder: Positional[Path]
    """The run folder."""


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """Say what is installed here and what can run."""


Command = (
    Annotated[Reconstruct, subcommand("reconstruct")]
    | Annotated[Check, subcommand("check")]
    | Annotated[Render, subcommand("render")]
    | Annotated[Report, subcommand("report")]
    | Annotated[Doctor, subcommand("doctor")]
)


def main(args: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    command: Any = tyro.cli(
        Command,  # pyright: ignore[reportArgumentType]
        prog="neoworld",
        description="One photograph in, a scene out that a robot can touch.",
        args=args,
        config=(FlagCreatePairsOff, DisallowNone),
    )
    sys.exit(run(command))


def run(command: Common) -> int:
    """Run a parsed command, print its answer and return the exit code."""
    _show_progress(quiet=command.quiet)
    with _reserved_stdout() if command.json else contextlib.nullcontext(sys.stdout) as out:
        try:
            answer = _COMMANDS[type(command)](command)
            code = FAILED if answer.get("passed") is False else 0
        except NeoWorldError as error:
            answer, code = {"error": str(error)}, BAD_INPUT
        except KeyboardInterrupt:
            answer, code = {"error": "interrupted; go on with --resume"}, INTERRUPTED
        except Exception as error:
            traceback.print_exc()
            answer, code = {"error": f"internal: {type(error).__name__}: {error}"}, BUG
        if "error" in answer:
            print(f"error: {answer['error']}", file=sys.stderr)
        if command.json:
            # NaN and Infinity are no JSON: they become null.
            strict = json.loads(json.dumps(answer), parse_constant=lambda _: None)
            print(json.dumps(strict), file=out, flush=True)
        elif "error" not in answer:
            _print(answer)
    return code


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
    )
    return result.summary()


def check(command: Check) -> Answer:
    """Measure a scene, or build a program and say what is wrong with it."""
    config = _config(command)
    if command.target.suffix == ".py":
        from .program import build

        built = build(_read(command.target), config.program)
        signals = [
            {"code": signal.code, **signal.model_dump(exclude_defaults=True)}
            for signal in built.signals
        ]
        return {"target": str(command.target), "passed": built.ok, "signals": signals}
    from .measure.scene import scene_measure

    limits = config.refine
    found = scene_measure(
        _scene(command.target),
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


def render(command: Render) -> Answer:
    """Ray-cast a scene with its own camera."""
    from .files import write_atomic
    from .render import render_scene, to_png

    options = _config(command).render
    scene = _scene(command.target)
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


def doctor(_: Doctor) -> Answer:
    """Look at this machine."""
    import platform

    import jax

    from .cache import cache_folder
    from .mllm.provider import bundled_tapes
    from .run_folder import versions

    kept = cache_folder()
    tapes = sorted(path.name for path in bundled_tapes().glob("*") if path.is_file())
    return {
        "system": platform.platform(),
        "cores": os.cpu_count(),
        "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
        "engines": {name: _engine(name) for name in ("native", "mjx", "warp")},
        "cache": {"folder": str(kept), "exists": kept.is_dir()},
        "keys": {name: bool(os.environ.get(name)) for name in _KEYS},
        "tapes": tapes,
        "versions": versions(),
    }


_KEYS = ("ANTHROPIC_API_KEY", "OPENAI_API_KEY")
_COMMANDS: dict[type, Any] = {
    Reconstruct: reconstruct,
    Check: check,
    Render: render,
    Report: report,
    Doctor: doctor,
}


def _engine(name: Any) -> str:
    from .physics.engine import open_engine

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


def _scene(target: Path) -> Any:
    """Read the scene of a run folder, or a scene.json."""
    from pydantic import ValidationError

    from .spec import SceneSpec

    file = target / "scene.json" if target.is_dir() else target
    if file.suffix != ".json":
        raise SpecError(f"{target}: expected a run folder, a scene.json or a program (.py)")
    try:
        return SceneSpec.model_validate_json(_read(file))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step) for step in first["loc"])
        raise SpecError(f"{file} is not a scene: {where or '(root)'}: {first['msg']}") from None


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise SpecError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SpecError(f"{path} is not a text file") from None


def _show_progress(*, quiet: bool) -> None:
    """Send the package's log to stderr as plain lines."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    log = logging.getLogger("neoworld_mjx")
    log.addHandler(handler)
    log.setLevel(logging.ERROR if quiet else logging.INFO)


@contextlib.contextmanager
def _reserved_stdout() -> Iterator[Any]:
    """Keep stdout for the answer: what Python or a C library prints meanwhile goes to stderr."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with (
            contextlib.redirect_stdout(sys.stderr),
            os.fdopen(os.dup(kept), "w", encoding="utf-8") as out,
        ):
            yield out
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def _print(answer: Answer, indent: str = "") -> None:
    """Print an answer for people."""
    for key, value in answer.items():
        if isinstance(value, dict):
            print(f"{indent}{key}:")
            _print(value, indent + "  ")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            print(f"{indent}{key}:")
            for item in value:
                print(f"{indent}  - " + ", ".join(f"{k} {_plain(v)}" for k, v in item.items()))
        else:
            print(f"{indent}{key}: {_plain(value)}")


def _plain(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value)) or "none"
    if isinstance(value, float):
        return f"{value:.5g}"
    if value is None or isinstance(value, bool):
        return {None: "unknown", True: "yes", False: "no"}[value]
    return str(value)


if __name__ == "__main__":
    main()
