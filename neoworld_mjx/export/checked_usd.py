"""Open USD files from other programs whose layers all lie in their folder.

Composition reads every layer that a file names, wherever it lies, so a child process opens the
file first.
"""

from pathlib import Path

from pxr import Sdf, Tf, Usd

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB, read_bytes
from ..io.names import printable
from .bounded_process import run_bounded

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MAX_LAYERS, MAX_PRIMS = 500, 200_000
_CODE = """
import os
from pxr import Sdf, Tf, Usd
file, max_prims = sys.argv[1], int(sys.argv[2])
home, waiting, visited = os.path.dirname(file) + os.sep, [file], set()
try:
    while waiting:
        name = waiting.pop()
        if name in visited:
            continue
        visited.add(name)
        real = os.path.realpath(name.partition("[")[0])
        if not real.startswith(home) or not os.path.isfile(real):
            sys.exit()
        layer = Sdf.Layer.FindOrOpen(name)
        if layer is None:
            print(os.path.basename(name) + " cannot be opened")
            sys.exit(3)
        names = layer.GetCompositionAssetDependencies()
        waiting += [Sdf.ComputeAssetPathRelativeToLayer(layer, name) for name in names]
    stage = Usd.Stage.Open(file)
    for count, _ in enumerate(stage.Traverse(Usd.TraverseInstanceProxies())):
        if count > max_prims:
            break
except Tf.ErrorException as error:
    print(" ".join(str(error).split()))
    sys.exit(3)
"""
"""Program of the child process: it reports invalid USD; the parent reports layers that are missing
or lie outside the folder."""
_INVALID = 3
"""Exit status of the child process for invalid USD."""


def open_usd(path: Path) -> Usd.Stage:
    """Open a USD file that may be hostile or broken.

    Raises:
        SpecError: it is not a USD file, is too large, names a layer that is missing or lies outside
            its folder, or USD exceeds its time or memory or crashes on it.
    """
    _check_file(path)
    status, output = run_bounded(
        path, _CODE, str(path.resolve()), str(MAX_PRIMS),
        library="USD", verb="open", accepted=(_INVALID,),
    )  # fmt: skip
    if status == _INVALID:
        # Opening the file in this process could take all memory before it fails.
        message = printable(output.decode("utf-8", "replace").strip())[:300]
        raise SpecError(f"{path} is not valid USD: {message}")
    return open_inside(path)


def open_inside(path: Path) -> Usd.Stage:
    """Open a USD file whose layers all lie in its folder.

    Raises:
        SpecError: it is not a USD file, or names a layer that is missing or lies outside.
    """
    _check_file(path)
    home = path.resolve().parent
    waiting, visited = [str(path.resolve())], set()
    while waiting:
        file = waiting.pop()
        if file in visited:
            continue
        visited.add(file)
        if len(visited) > MAX_LAYERS:
            raise SpecError(f"{path} has more than {MAX_LAYERS} layers")
        try:
            layer = Sdf.Layer.FindOrOpen(file)
        except Tf.ErrorException as error:
            raise SpecError(f"{path} is not valid USD: {_line(error)}") from None
        if layer is None:
            raise SpecError(f"{path} is not valid USD: {Path(file).name} cannot be opened")
        for named in layer.GetCompositionAssetDependencies():
            waiting.append(_inside(path, home, layer, named))
    try:
        stage = Usd.Stage.Open(str(path.resolve()), Usd.Stage.LoadAll)
    except Tf.ErrorException as error:
        raise SpecError(f"{path} cannot be composed: {_line(error)}") from None
    for count, _ in enumerate(stage.Traverse(Usd.TraverseInstanceProxies())):
        if count > MAX_PRIMS:
            raise SpecError(f"{path} has more than {MAX_PRIMS} prims")
    return stage


def _check_file(path: Path) -> None:
    if path.suffix.lower() not in SUFFIXES:
        raise SpecError(f"{path}: USD files end in {', '.join(SUFFIXES)}")
    try:
        head = read_bytes(path, file_bounds().max_mesh_mib * MIB)[:8]
    except OSError as error:
        raise SpecError(f"cannot read {path}: {error.strerror}") from None
    if not head.startswith((b"#usda", b"#sdf", b"PXR-USDC", b"PK")):
        raise SpecError(f"{path} is not valid USD: its first bytes are not those of a USD file")


def _inside(path: Path, home: Path, layer: Sdf.Layer, named: str) -> str:
    """Return the identifier of a layer that another layer names."""
    target = Sdf.ComputeAssetPathRelativeToLayer(layer, named)
    file = target.partition("[")[0]
    if ":" in file or not file:
        raise SpecError(f"{path} names {named!r}, which is not a file in its folder")
    real = (home / file).resolve()
    if not real.is_relative_to(home):
        raise SpecError(f"{path} names {named!r}, which lies outside its folder {home}")
    if not real.is_file():
        raise SpecError(f"{path} names {named!r}, which does not exist")
    _check_file(real)
    return target


def _line(error: Exception) -> str:
    text = " ".join(str(error).split())
    # The message begins with a location in the library's source.
    return text.partition(": '")[2][:240] or text[:240]
