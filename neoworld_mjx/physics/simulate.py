"""Functions that open an engine by name, and that roll out layouts in one call."""

import contextlib
from importlib import import_module

import jax

from ..engines import ENGINES
from ..errors import EngineError, SpecError, choices
from .engine import EarlyStop, Engine, Rollout
from .layout import Layout
from .model import SceneModel


def open_engine(name: str = "auto") -> Engine:
    """Return an engine by name.

    `auto` is `native` if JAX computes on the CPU, else `warp` if it can run on this machine, else
    `mjx`.

    Raises:
        EngineError: the engine is unknown or cannot run on this machine.
    """
    if name == "auto":
        if jax.default_backend() == "cpu":
            return open_engine("native")
        try:
            return open_engine("warp")
        except EngineError:
            return open_engine("mjx")
    if name not in ENGINES:
        raise EngineError(f"engine: {choices(name, ['auto', *ENGINES])}")
    module, _, cls = ENGINES[name].location.partition(":")
    # Imported lazily, since not every engine's dependencies are installed.
    return getattr(import_module(module, __name__.rsplit(".", 2)[0]), cls)()


def rollout(
    scene: SceneModel,
    layouts: Layout,
    *,
    engine: str | Engine = "auto",
    duration: float = 1.0,
    record_every: float = 0.1,
    early_stop: EarlyStop | None = None,
) -> Rollout:
    """Place candidate layouts and roll them out; see `Engine.rollout`.

    This function runs on the host and cannot be jitted, vmapped or differentiated. By contrast,
    `SceneModel.place` and functions of a `Rollout` can.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        engine: name of an engine, or an opened engine.
        duration: simulated time [s].
        record_every: time between recorded poses [s].
        early_stop: conditions for stopping candidates early; if None, all are simulated to the end.

    Raises:
        EngineError: the engine is unknown or cannot run on this machine.
        SpecError: `scene` is not a SceneModel, or `layouts` not a Layout of it.
    """
    if not isinstance(scene, SceneModel):
        raise SpecError(
            f"rollout: scene is a {type(scene).__name__}, not a SceneModel: load a file or run "
            "folder with load_scene, or compile a SceneSpec with compile_scene"
        )
    if not isinstance(layouts, Layout):
        raise SpecError(
            f"rollout: layouts is a {type(layouts).__name__}, not a Layout: Layout.zero("
            f"pop, {len(scene.names)}) is pop copies of the composed scene"
        )
    if layouts.yaw.ndim != 2 or layouts.yaw.shape[1] != len(scene.names):
        raise SpecError(
            f"rollout: layouts.yaw has shape {tuple(layouts.yaw.shape)}, not (pop, "
            f"{len(scene.names)}): scene {scene.spec.name} has {len(scene.names)} objects"
        )
    return (open_engine(engine) if isinstance(engine, str) else engine).rollout(
        scene,
        scene.place(layouts),
        duration=duration,
        record_every=record_every,
        early_stop=early_stop,
    )


def on_cpu() -> contextlib.AbstractContextManager[object]:
    """Return a context in which JAX runs on the CPU.

    It is meant for computations that a GPU would spend mainly on kernel launches. The context does
    nothing if JAX has no CPU backend, or if the CPU is the default backend: naming the default
    device would compile every function once more.
    """
    if jax.default_backend() == "cpu":
        return contextlib.nullcontext()
    try:
        return jax.default_device(jax.devices("cpu")[0])
    except RuntimeError:
        return contextlib.nullcontext()
