"""Programs kept as they were traced and lowered, so that a new process does neither again.

JAX keeps what it compiles on disk, but finds it by the lowered program, and tracing and lowering
one takes longer than reading it. Beside that cache the lowered programs themselves are kept, by
`jax.export`. They are found by the sources that they come from, the versions of the libraries, and
the shapes of what they take; a program gives the same bits whether it was read or traced.
"""

import contextlib
import functools
import hashlib
import importlib.metadata
import importlib.util
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.export
import numpy as np
from jax.core import Tracer

from .io.files import MIB, read_bytes, write_atomic

_ROOMS = ("config", "measure", "physics", "refinement", "spec")
SOURCES = (*(f"neoworld_mjx/{room}" for room in _ROOMS), "neoworld_kernels")
"""Packages that programs are traced from, with those whose constants they may hold."""
TRACED_LIBRARIES = ("jax", "jaxlib", "equinox", "optax", "numpy")
MOST_PROGRAMS, MAX_BYTES = 64, 64 * MIB
"""Programs that are kept, of more the oldest are removed; and the largest that is read."""
_Program = Callable[..., Any]


def kept(fn: Callable[..., Any], like: Callable[..., Any]) -> Callable[..., Any]:
    """Return a jitted function whose traces are kept on disk.

    They are kept on CPUs, where tracing takes seconds of few cores, and only where JAX keeps what
    it compiles. Within another traced function it is `fn` itself.

    Args:
        fn: a jitted function of arrays, and of keywords that are compiled in.
        like: given the same arrays, returns a tree of the form of its result; traced.
    """
    programs: dict[Any, tuple[_Program, Any]] = {}

    @functools.wraps(fn)
    def call(*args: Any, **static: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        if not _keeps(leaves):
            return fn(*args, **static)
        avals = tuple((np.shape(x), str(jax.dtypes.canonicalize_dtype(x.dtype))) for x in leaves)
        form, options = str(tree), tuple(sorted(static.items()))
        if " at 0x" in form:
            # Data of the host are compiled in, which only this process knows.
            return fn(*args, **static)
        key = (form, avals, options)
        if key not in programs:
            flat = lambda *flat: jax.tree.leaves(fn(*jax.tree.unflatten(tree, flat), **static))
            program = _open(flat, f"{fn.__module__}.{fn.__qualname__}{key}", avals)
            programs[key] = program, jax.tree.structure(jax.eval_shape(like, *args))
        program, result = programs[key]
        return jax.tree.unflatten(result, program(*leaves))

    return call


def computes_on_cpu() -> bool:
    """Whether JAX computes on the CPU now: it has nothing else, or `jax.default_device` says so."""
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    if chosen is None:
        return jax.default_backend() == "cpu"
    return (chosen if isinstance(chosen, str) else chosen.platform).startswith("cpu")


def _keeps(leaves: list[Any]) -> bool:
    """Whether arrays are those of a call on a CPU, by a process that keeps what it compiles."""
    for x in leaves:
        if isinstance(x, Tracer) or not isinstance(x, np.ndarray | np.generic | jax.Array):
            return False
    return _folder() is not None and computes_on_cpu()


def _folder() -> Path | None:
    chosen = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    return Path(chosen) / "traces" if chosen else None


def _open(flat: _Program, name: str, avals: tuple[Any, ...]) -> _Program:
    """Read a program, or trace it and keep it."""
    folder = _folder()
    assert folder is not None
    path = folder / f"{_fingerprint(name)}.bin"
    exported = None
    # Whatever a damaged file does: it is traced again, and written anew.
    with contextlib.suppress(Exception):
        exported = jax.export.deserialize(bytearray(read_bytes(path, MAX_BYTES)))
    if exported is None:
        shapes = [jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in avals]
        exported = jax.export.export(jax.jit(flat), platforms=("cpu",))(*shapes)
        _keep(path, exported)
    return jax.jit(exported.call)


def _keep(path: Path, exported: jax.export.Exported) -> None:
    # Where it cannot be written it costs time only.
    with contextlib.suppress(OSError, ImportError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, bytes(exported.serialize()))
        for old in sorted(path.parent.glob("*.bin"), key=os.path.getmtime)[:-MOST_PROGRAMS]:
            old.unlink(missing_ok=True)


def _fingerprint(name: str) -> str:
    return hashlib.sha256(f"{_sources()} {name}".encode()).hexdigest()


@functools.cache
def _sources() -> str:
    """Return the hash of the sources and versions that programs depend on."""
    digest = hashlib.sha256()
    for library in TRACED_LIBRARIES:
        digest.update(f"{library} {importlib.metadata.version(library)} ".encode())
    for place in SOURCES:
        package = place.split("/")[0]
        spec = importlib.util.find_spec(package)
        assert spec is not None and spec.origin is not None
        root = Path(spec.origin).parent.joinpath(*place.split("/")[1:])
        for path in sorted(root.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()
