"""The engine that `auto` opens, by hardware, and the memory that JAX leaves to it."""

import jax
import pytest

from neoworld_mjx.engines import ENGINES
from neoworld_mjx.errors import EngineError
from neoworld_mjx.physics.engine import open_engine


@pytest.mark.parametrize(
    ("backend", "runs", "opened"),
    [
        ("cpu", ("warp", "mjx", "native"), "native"),
        ("gpu", ("warp", "mjx", "native"), "warp"),
        ("gpu", ("mjx", "native"), "mjx"),
        ("tpu", ("mjx", "native"), "mjx"),
    ],
)
def test_auto_is_native_on_a_cpu_else_warp_or_mjx(monkeypatch, backend, runs, opened):
    class Engine:
        def __init__(self, name):
            self.name = name
            if name not in runs:
                raise EngineError(f"{name} is not installed")

        def rollout(self, *_, **__):
            raise AssertionError("nothing is rolled out")

    for name, entry in ENGINES.items():
        monkeypatch.setitem(ENGINES, name, entry._replace(location=f"{__name__}:{name}"))
        monkeypatch.setitem(globals(), name, lambda name=name: Engine(name))
    monkeypatch.setattr(jax, "default_backend", lambda: backend)
    assert open_engine("auto").name == opened
    with pytest.raises(EngineError, match="did you mean 'native'"):
        open_engine("nativ")
