"""Rewards of a user: functions of (obs, action, data, previous), or files that define them."""

import importlib.util
import inspect
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax

from ..errors import SpecError, choices
from .controlled_scene import ControlledScene

Reward = Callable[..., Any]
"""Function of the observation, or of (obs, action, data, previous): the observations by name, the
action, and the `SceneState` after and before it. It returns one number. A function with a parameter
`controlled` is also given the `ControlledScene`, which has the names of joints and handles."""


def with_four_arguments(reward: Reward, controlled: ControlledScene) -> Reward:
    """Return a reward of (obs, action, data, previous); the given one may take only the first.

    Args:
        reward: the function.
        controlled: the scene that it gets if it has a parameter of this name.

    Raises:
        SpecError: the function takes neither one nor four arguments.
    """
    try:
        signature = inspect.signature(reward)
    except (TypeError, ValueError):  # a built-in function
        return lambda obs, action, data, previous: reward(obs)
    if "controlled" in signature.parameters:
        reward = partial(reward, controlled=controlled)
        signature = inspect.signature(reward)
    for count in (4, 1):
        try:
            signature.bind(*range(count))
        except TypeError:
            continue
        return reward if count == 4 else lambda obs, action, data, previous: reward(obs)
    raise SpecError(
        f"reward: takes {signature}; it must take the observation, or (obs, action, data, previous)"
    )


def traced_reward(reward: Reward, controlled: ControlledScene, *arguments: Any) -> Reward:
    """Return a reward of four arguments that JAX can trace.

    Args:
        reward: the function.
        controlled: as for `with_four_arguments`.
        arguments: example arguments (obs, action, data, previous).

    Raises:
        SpecError: JAX cannot trace the function, or it does not return one number.
    """
    four = with_four_arguments(reward, controlled)
    try:
        shape = jax.eval_shape(four, *arguments).shape
    except KeyError as error:
        names = choices(str(error.args[0] if error.args else ""), arguments[0])
        raise SpecError(f"reward {reward_name(reward)}: names of observations: {names}") from None
    except SpecError as error:
        raise SpecError(f"reward {reward_name(reward)}: {error}") from None
    except Exception as error:  # The function of a user may raise anything.
        first = str(error).strip().splitlines()[0] if str(error).strip() else ""
        raise SpecError(
            f"reward {reward_name(reward)}: JAX cannot trace it ({type(error).__name__}: {first}); "
            "use jax.numpy on its arguments, without float() or if"
        ) from None
    if shape != ():
        raise SpecError(f"reward {reward_name(reward)}: returns shape {shape}, not one number")
    return four


def reward_name(reward: Reward) -> str:
    """Return the name of a reward, for messages and records."""
    return getattr(reward, "__qualname__", type(reward).__qualname__)


def read_reward(text: str) -> Reward:
    """Import a reward that the user names as FILE.py:function.

    Importing runs the file, so call it only with what the user typed, never with a name that a file
    of a run folder or a policy has.

    Raises:
        SpecError: the text has another form, or the file or its function cannot be imported.
    """
    file, _, name = text.rpartition(":")
    path = Path(file)
    if path.suffix != ".py" or not name.isidentifier():
        raise SpecError(f"reward: {text!r} is not of the form FILE.py:function")
    if not path.is_file():
        raise SpecError(f"reward: there is no file {path}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # Importing a file may raise anything.
        raise SpecError(f"reward: cannot import {path} ({type(error).__name__}: {error})") from None
    reward = getattr(module, name, None)
    if not callable(reward):
        own = [key for key, value in vars(module).items() if inspect.isfunction(value)]
        raise SpecError(f"reward: {path} has no function {name}; it has: {', '.join(own)}")
    return reward
