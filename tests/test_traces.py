"""Kept traces give the same bits, are read and not traced again, and never stand in the way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx import traces


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """A function of a tree, how often it was traced, and a way to open it as a new process does."""
    monkeypatch.setattr(traces, "_folder", lambda: tmp_path / "traces")
    calls = []

    @jax.jit
    def turned(tree):
        calls.append(1)
        return {"out": jnp.sin(tree["a"]) / tree["b"]}

    return (
        calls,
        tmp_path / "traces",
        lambda: traces.stored_trace(turned, lambda tree: {"out": tree["a"]}),
        turned,
    )


def test_a_stored_trace_is_read_by_the_next_process_and_is_bit_identical(counted):
    calls, folder, new, plain = counted
    tree = {"a": np.linspace(0, 1, 7, dtype=np.float32), "b": np.float32(3)}
    first = new()(tree)["out"]
    traced = len(calls)
    assert traced == 1 and len(list(folder.glob("*.bin"))) == 1
    assert np.array_equal(new()(tree)["out"], first)
    assert len(calls) == traced
    assert np.array_equal(plain(tree)["out"], first)
    new()({"a": np.ones(3, np.float32), "b": np.float32(3)})
    assert len(list(folder.glob("*.bin"))) == 2


def test_a_damaged_trace_is_traced_again(counted):
    _, folder, new, _ = counted
    tree = {"a": np.ones(2, np.float32), "b": np.float32(2)}
    first = new()(tree)["out"]
    (path,) = folder.glob("*.bin")
    path.write_bytes(b"no program")
    assert np.array_equal(new()(tree)["out"], first)
    assert path.stat().st_size > 100


def test_nothing_is_stored_within_another_trace_or_without_a_folder(counted, monkeypatch):
    _, folder, new, plain = counted
    tree = {"a": np.ones((4, 2), np.float32), "b": np.full(4, 2, np.float32)}
    assert np.array_equal(jax.vmap(new())(tree)["out"], jax.vmap(plain)(tree)["out"])
    monkeypatch.setattr(traces, "_folder", lambda: None)
    assert new()(tree | {"b": np.float32(2)})["out"].shape == (4, 2)
    assert not folder.exists()


def test_only_the_newest_traces_are_stored(counted, monkeypatch):
    _, folder, new, _ = counted
    monkeypatch.setattr(traces, "MAX_PROGRAMS", 2)
    for n in (1, 2, 3):
        new()({"a": np.ones(n, np.float32), "b": np.float32(2)})
    assert len(list(folder.glob("*.bin"))) == 2


def test_traces_are_stored_for_the_cpu_of_an_accelerator_host(counted, monkeypatch):
    calls, folder, new, _ = counted
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    tree = {"a": np.ones(3, np.float32), "b": np.float32(2)}
    new()(tree)
    assert not folder.exists()
    with jax.default_device(jax.devices("cpu")[0]):
        first = new()(tree)["out"]
        traced = len(calls)
        assert np.array_equal(new()(tree)["out"], first)
    assert len(list(folder.glob("*.bin"))) == 1 and len(calls) == traced
