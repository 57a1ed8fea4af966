"""USD files from elsewhere: their layers lie in their folder, another process opens them first.

Composition reads every layer that a file names, wherever it lies, and a few bytes can make the
library take all memory or break down.
"""

import subprocess
import sys
from pathlib import Path

from pxr import Sdf, Tf, Usd

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB, read_bytes
from ..io.names import printable

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MAX_LAYERS, MAX_PRIMS = 500, 200_000
_MEMORY = 4096 * MIB
_CODE = """
import os, resource, sys
file, most = sys.argv[1], int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
resource.setrlimit(resource.RLIMIT_AS, (most, most))
from pxr import Sdf, Tf, Usd
home, waiting, seen = os.path.dirname(file) + os.sep, [file], set()
try:
    while waiting:
        one = waiting.pop()
        if one in seen:
            continue
        seen.add(one)
        real = os.path.realpath(one.partition("[")[0])
        if not real.startswith(home) or not os.path.isfile(real):
            sys.exit()
        layer = Sdf.Layer.FindOrOpen(one)
        if layer is None:
            print(os.path.basename(one) + " cannot be opened")
            sys.exit(3)
        names = layer.GetCompositionAssetDependencies()
        waiting += [Sdf.ComputeAssetPathRelativeToLayer(layer, name) for name in names]
    stage = Usd.Stage.Open(file)
    for count, _ in enumerate(stage.Traverse(Usd.TraverseInstanceProxies())):
        if count > int(sys.argv[3]):
            break
except Tf.ErrorException as error:
    print(" ".join(str(error).split()))
    sys.exit(3)
"""
"""What the other process does: it says what is no whole USD, this one what lies elsewhere or is
not there."""
_BROKEN = 3
"""Exit code of the other process for such a file."""


def open_usd(path: Path) -> Usd.Stage:
    """Open a USD file that may be hostile or broken.

    Raises:
        SpecError: it is no USD file, is too large, names a layer that is not there or lies outside
            its folder, or USD takes too long or breaks down on it.
    """
    seconds = file_bounds().timeout_s
    _check_file(path)
    try:
        done = subprocess.run(
            [sys.executable, "-c", _CODE, str(path.resolve()), str(_MEMORY), str(MAX_PRIMS)],
            capture_output=True,
            check=False,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        raise SpecError(
            f"{path}: USD takes over {seconds:g} s to open it; make it smaller, or raise "
            "files.timeout_s if you trust it"
        ) from None
    if done.returncode == _BROKEN:
        # Opening it once more here could take all memory before it fails.
        said = printable(done.stdout.decode("utf-8", "replace").strip())[:300]
        raise SpecError(f"{path} is no whole USD: {said}")
    if done.returncode:
        last = done.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
        raise SpecError(
            f"{path}: USD cannot open it within {_MEMORY // MIB} MiB of memory, or breaks down on "
            f"it ({' '.join(last)[:200] or f'signal {-done.returncode}'})"
        )
    return open_inside(path)


def open_inside(path: Path) -> Usd.Stage:
    """Open a USD file whose layers all lie in its folder.

    Raises:
        SpecError: it is no USD file, or names a layer that is not there or lies elsewhere.
    """
    _check_file(path)
    home = path.resolve().parent
    waiting, seen = [str(path.resolve())], set()
    while waiting:
        file = waiting.pop()
        if file in seen:
            continue
        seen.add(file)
        if len(seen) > MAX_LAYERS:
            raise SpecError(f"{path} is made of more than {MAX_LAYERS} layers")
        try:
            layer = Sdf.Layer.FindOrOpen(file)
        except Tf.ErrorException as error:
            raise SpecError(f"{path} is no whole USD: {_line(error)}") from None
        if layer is None:
            raise SpecError(f"{path} is no whole USD: {Path(file).name} cannot be opened")
        for named in layer.GetCompositionAssetDependencies():
            waiting.append(_inside(path, home, layer, named))
    try:
        stage = Usd.Stage.Open(str(path.resolve()), Usd.Stage.LoadAll)
    except Tf.ErrorException as error:
        raise SpecError(f"{path} cannot be composed: {_line(error)}") from None
    for count, _ in enumerate(stage.Traverse(Usd.TraverseInstanceProxies())):
        if count > MAX_PRIMS:
            raise SpecError(f"{path} holds more than {MAX_PRIMS} prims")
    return stage


def _check_file(path: Path) -> None:
    if path.suffix.lower() not in SUFFIXES:
        raise SpecError(f"{path}: USD files end in {', '.join(SUFFIXES)}")
    try:
        head = read_bytes(path, file_bounds().max_mesh_mib * MIB)[:8]
    except OSError as error:
        raise SpecError(f"cannot read {path}: {error.strerror}") from None
    if not head.startswith((b"#usda", b"#sdf", b"PXR-USDC", b"PK")):
        raise SpecError(f"{path} is no whole USD: it does not begin as one")


def _inside(path: Path, home: Path, layer: Sdf.Layer, named: str) -> str:
    """Return the identifier of a layer that another names.

    Raises:
        SpecError: it lies outside the file's folder, or is not there.
    """
    target = Sdf.ComputeAssetPathRelativeToLayer(layer, named)
    file = target.partition("[")[0]
    if ":" in file or not file:
        raise SpecError(f"{path} names {named!r}, which is no file of its folder")
    real = (home / file).resolve()
    if not real.is_relative_to(home):
        raise SpecError(f"{path} names {named!r}, which lies outside its folder {home}")
    if not real.is_file():
        raise SpecError(f"{path} names {named!r}, and there is no such file")
    _check_file(real)
    return target


def _line(error: Exception) -> str:
    text = " ".join(str(error).split())
    # The place in the library's source comes first.
    return text.partition(": '")[2][:240] or text[:240]
