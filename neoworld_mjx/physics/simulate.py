"""Opening an engine by name, and rolling layouts out in one call."""

import contextlib
from typing import get_args

import jax

from ..config import EngineName
from ..errors import EngineError, choices
from .engine import EarlyStop, Engine, Rollout
from .layout import Layout
from .model import SceneModel


def open_engine(name: EngineName = "auto") -> Engine:
    """Return an engine by name.

    `auto` is warp on an NVIDIA GPU when it is installed, else mjx on an accelerator, else native.

    Raises:
        EngineError: the engine is unknown, or cannot run here.
    """
    if name == "auto":
        name = _automatic()
    if name == "native":
        from .native import NativeEngine

        return NativeEngine()
    if name == "mjx":
        from .mjx_engine import MjxEngine

        return MjxEngine()
    if name == "warp":
        from .warp_engine import WarpEngine

        return WarpEngine()
    raise EngineError(f"engine: {choices(name, get_args(EngineName))}")


def _automatic() -> EngineName:
    from .warp_engine import warp_ready

    if warp_ready():
        return "warp"
    return "native" if jax.default_backend() == "cpu" else "mjx"


def rollout(
    scene: SceneModel,
    layouts: Layout,
    *,
    engine: EngineName = "auto",
    duration: float = 1.0,
    record_every: float = 0.1,
    early_stop: EarlyStop | None = None,
) -> Rollout:
    """Place candidate layouts and roll them out; see `Engine.rollout`.

    Args:
        scene: the compiled scene.
        layouts: the candidates.
        engine: auto, mjx, warp or native.
        duration: simulated time [s].
        record_every: time between recorded poses [s].
        early_stop: rules for stopping candidates early; None simulates all of them to the end.

    Raises:
        EngineError: the engine is unknown, or cannot run here.
    """
    return open_engine(engine).rollout(
        scene,
        scene.place(layouts),
        duration=duration,
        record_every=record_every,
        early_stop=early_stop,
    )


def on_cpu() -> contextlib.AbstractContextManager[object]:
    """Let JAX compute on the CPU what a GPU would only start kernels for.

    Nothing changes where JAX's settings leave it no CPU.
    """
    try:
        return jax.default_device(jax.devices("cpu")[0])
    except RuntimeError:
        return contextlib.nullcontext()
