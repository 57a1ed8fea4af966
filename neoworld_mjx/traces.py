"""Persistent cache of lowered functions, which saves tracing and lowering in a new process.

JAX's compilation cache is keyed by the lowered function. A new process must therefore trace and
lower a function before it can read the compiled one, and this takes longer than reading. This cache
stores functions that `jax.export` lowered. Their keys contain the source code, the versions of
libraries and the shapes of arguments. Results are bit-identical with and without the cache.
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

_PACKAGES = ("config", "measure", "physics", "refinement", "spec")
SOURCES = (*(f"neoworld_mjx/{name}" for name in _PACKAGES), "neoworld_kernels")
"""Packages whose functions are traced, or whose constants traced functions may contain."""
TRACED_LIBRARIES = ("jax", "jaxlib", "equinox", "optax", "numpy")
MAX_PROGRAMS, MAX_BYTES = 64, 64 * MIB
"""Number of stored functions beyond which the oldest are removed, and size of the largest file that
is read [bytes]."""
_Program = Callable[..., Any]


def stored_trace(fn: Callable[..., Any], like: Callable[..., Any]) -> Callable[..., Any]:
    """Return a jitted function whose lowered form is stored on disk.

    The lowered form is stored only on CPUs, where tracing takes seconds, and only if JAX's
    compilation cache is enabled. Within another traced function, `fn` itself is called.

    Args:
        fn: a jitted function of arrays and static keyword arguments.
        like: a function of the same arrays whose result has the same tree structure as the result
            of `fn`. It is evaluated only abstractly, by `jax.eval_shape`.
    """
    programs: dict[Any, tuple[_Program, Any]] = {}

    @functools.wraps(fn)
    def call(*args: Any, **static: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        if not _is_stored(leaves):
            return fn(*args, **static)
        avals = tuple((np.shape(x), str(jax.dtypes.canonicalize_dtype(x.dtype))) for x in leaves)
        form, options = str(tree), tuple(sorted(static.items()))
        if " at 0x" in form:
            # The tree structure refers to objects that exist only in this process.
            return fn(*args, **static)
        key = (form, avals, options)
        if key not in programs:

            def flat(*flat_args: Any) -> list[Any]:
                return jax.tree.leaves(fn(*jax.tree.unflatten(tree, flat_args), **static))

            program = _open(flat, f"{fn.__module__}.{fn.__qualname__}{key}", avals)
            programs[key] = program, jax.tree.structure(jax.eval_shape(like, *args))
        program, result = programs[key]
        return jax.tree.unflatten(result, program(*leaves))

    return call


def computes_on_cpu() -> bool:
    """Return True if JAX computes on the CPU, by default or because of `jax.default_device`."""
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    if chosen is None:
        return jax.default_backend() == "cpu"
    return (chosen if isinstance(chosen, str) else chosen.platform).startswith("cpu")


def _is_stored(leaves: list[Any]) -> bool:
    """Return True if the lowered function for these arguments can be stored."""
    concrete = (np.ndarray, np.generic, jax.Array)
    if any(isinstance(x, Tracer) or not isinstance(x, concrete) for x in leaves):
        return False
    return _folder() is not None and computes_on_cpu()


def _folder() -> Path | None:
    chosen = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    return Path(chosen) / "traces" if chosen else None


def _open(flat: _Program, name: str, avals: tuple[Any, ...]) -> _Program:
    """Read a lowered function; if that fails, trace, lower and store it."""
    folder = _folder()
    assert folder is not None
    path = folder / f"{_fingerprint(name)}.bin"
    exported = None
    # A missing or damaged file is written anew.
    with contextlib.suppress(Exception):
        exported = jax.export.deserialize(bytearray(read_bytes(path, MAX_BYTES)))
    if exported is None:
        shapes = [jax.ShapeDtypeStruct(shape, dtype) for shape, dtype in avals]
        exported = jax.export.export(jax.jit(flat), platforms=("cpu",))(*shapes)
        _store(path, exported)
    return jax.jit(exported.call)


def _store(path: Path, exported: jax.export.Exported) -> None:
    # If writing fails, the next process traces the function again.
    with contextlib.suppress(OSError, ImportError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, bytes(exported.serialize()))
        for old in sorted(path.parent.glob("*.bin"), key=os.path.getmtime)[:-MAX_PROGRAMS]:
            old.unlink(missing_ok=True)


def _fingerprint(name: str) -> str:
    return hashlib.sha256(f"{_sources()} {name}".encode()).hexdigest()


@functools.cache
def _sources() -> str:
    """Return a hash of the source files and library versions that traced functions depend on."""
    digest = hashlib.sha256()
    for library in TRACED_LIBRARIES:
        digest.update(f"{library} {importlib.metadata.version(library)} ".encode())
    for source in SOURCES:
        package, *subpackages = source.split("/")
        spec = importlib.util.find_spec(package)
        assert spec is not None and spec.origin is not None
        root = Path(spec.origin).parent.joinpath(*subpackages)
        for path in sorted(root.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()
