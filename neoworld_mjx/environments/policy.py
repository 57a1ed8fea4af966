"""A trained policy and its file: one .npz of arrays and a description, without pickled objects.

The file also holds the rest of the state of the optimization, so training resumes from it.
"""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from ..errors import SpecError
from ..io.binary_files import read_arrays
from ..io.files import write_output
from .networks import Actor, Layer, Normalizer, mlp
from .robots import Mount

POLICY = "policy.npz"
"""Name of the policy in the folder of a training."""
ACTION_S = 0.04
"""Duration of an action [s]."""
MAX_LAYERS, MAX_WIDTH = 16, 8192


class Setting(BaseModel):
    """Task, robot and timing of a policy, the same for training and evaluation."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    task: str = Field(max_length=2000)
    robot: str | None = Field(default=None, max_length=1000)
    mount: Mount | None = None
    gripper: str | None = Field(default=None, max_length=1000)
    """Handle that a free-flying gripper faces, instead of a robot."""
    without: tuple[str, ...] = Field(default=(), max_length=500)
    """Objects that are left out."""
    control_s: float = Field(default=ACTION_S, gt=0, le=1)
    """Duration of an action [s]."""
    horizon: int = Field(default=125, gt=0, le=100_000)
    """Actions of an episode."""
    delay_steps: int = Field(default=0, ge=0, le=100)
    """Largest delay of actions [control steps]; each episode has its own, from 0 to this."""


class About(BaseModel):
    """Description in a policy file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: int = Field(default=1, ge=1, le=1)
    setting: Setting
    scene: str = Field(max_length=200)
    """Hash of the scene in which the policy was trained."""
    seed: int
    steps: int = Field(ge=0)
    """Control steps of training."""
    samples: int = Field(ge=0)
    """Draws of the scene in training; 0 if there was only the scene itself."""
    reward: str = Field(default="", max_length=200)
    """Name of the user's reward; empty for that of the task. Nothing imports it."""
    options: dict[str, int | float | tuple[int, ...]] = Field(default={}, max_length=50)
    """Settings of the optimization."""


@dataclass(frozen=True, eq=False)
class Policy:
    """Network that maps a vector of observations to the mean of its actions."""

    about: About
    actor: Actor
    normalizer: Normalizer
    rest: tuple[NDArray, ...] = ()
    """Other arrays of the state of the optimization, from which training resumes."""

    @property
    def observation_size(self) -> int:
        """Length of an observation."""
        return len(self.normalizer.mean)

    def act(self, obs: Float[NDArray, "*batch obs"]) -> Float[NDArray, "*batch action"]:
        """Return the most likely actions, whose entries are about 1 in size."""
        return mlp(self.actor.layers, self.normalizer(obs, np), np)

    def write(self, path: Path) -> None:
        """Write the policy as a .npz file."""
        arrays: dict[str, Any] = {"about": np.array(self.about.model_dump_json())}
        for k, layer in enumerate(self.actor.layers):
            arrays |= {f"weight_{k}": layer.weight, f"bias_{k}": layer.bias}
        arrays |= {"log_std": self.actor.log_std}
        arrays |= self.normalizer._asdict()
        arrays |= {f"rest_{k}": array for k, array in enumerate(self.rest)}
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **{k: np.asarray(v) for k, v in arrays.items()})
        write_output(path, buffer.getvalue(), SpecError)


def read_policy(path: Path | str) -> Policy:
    """Read a policy file, or that of the folder of a training; either may come from a stranger.

    Raises:
        SpecError: the file cannot be read, is too large, or is no policy.
    """
    path = Path(path)
    path = path / POLICY if path.is_dir() else path
    arrays = read_arrays(path, SpecError)
    try:
        text = arrays.pop("about")
        about = About.model_validate_json(str(text.reshape(())))
        count = sum(name.startswith("weight_") for name in arrays)
        if not 0 < count <= MAX_LAYERS:
            raise ValueError(f"it has {count} layers")
        layers = tuple(Layer(arrays[f"weight_{k}"], arrays[f"bias_{k}"]) for k in range(count))
        actor = Actor(layers, arrays["log_std"])
        normalizer = Normalizer(arrays["seen"], arrays["mean"], arrays["squares"])
        others = sum(name.startswith("rest_") for name in arrays)
        rest = tuple(arrays[f"rest_{k}"] for k in range(others))
    except (KeyError, ValueError) as error:
        first = str(error).splitlines()[0]
        raise SpecError(f"{path}: it is not a policy file: {first}") from None
    _check(path, actor, normalizer)
    return Policy(about, actor, normalizer, rest)


def _check(path: Path, actor: Actor, normalizer: Normalizer) -> None:
    """Refuse shapes that do not fit, and values that are not finite."""
    width = normalizer.mean.shape
    leaves = [*normalizer, actor.log_std, *(a for layer in actor.layers for a in layer)]
    if not all(a.dtype.kind == "f" and np.isfinite(a).all() for a in leaves):
        raise SpecError(f"{path}: it is not a policy file: a value is not a finite number")
    sizes = [normalizer.seen.shape == (), normalizer.squares.shape == width, len(width) == 1]
    for layer in actor.layers:
        sizes.append(layer.weight.ndim == 2 and (layer.weight.shape[0],) == width)
        width = layer.bias.shape
        sizes.append(layer.weight.shape[1:] == width and max(layer.weight.shape) <= MAX_WIDTH)
    if not all(sizes) or actor.log_std.shape != width:
        raise SpecError(f"{path}: it is not a policy file: the shapes of its layers do not fit")
