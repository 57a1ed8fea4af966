"""Opens untrusted USD files, provided that all of their layers are in the folder of the file.

When USD composes a stage, it reads every layer that a file refers to, in any folder. Therefore the
layers are opened and checked one by one before the stage is composed.
"""

from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd

from ..errors import SpecError
from ..io import file_bounds
from ..io.files import MIB, read_bytes
from ..io.names import plain_text

SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MAX_LAYERS, MAX_PRIMS, MAX_BODIES = 500, 200_000, 2000


def open_usd(path: Path) -> Usd.Stage:
    """Open a USD file after checking that all of its layers are in the folder of the file.

    Raises:
        SpecError: the file is not a USD file, has value clips, is too large, or refers to a layer
            that is missing or outside the folder.
    """
    _check_file(path)
    folder = path.resolve().parent
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
        _check_prims(path, layer)
        for dependency in layer.GetCompositionAssetDependencies():
            waiting.append(_inside(path, folder, layer, dependency))
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
        raise SpecError(f"{path} is not valid USD: it does not begin like a USD file")


def _inside(path: Path, folder: Path, layer: Sdf.Layer, reference: str) -> str:
    """Return the identifier of a layer that another layer refers to, if it is in the folder."""
    target = Sdf.ComputeAssetPathRelativeToLayer(layer, reference)
    file = target
    if Ar.IsPackageRelativePath(target):
        file = Ar.SplitPackageRelativePathOuter(target)[0]
    if ":" in file or not file.startswith("/"):
        raise SpecError(f"{path} names {reference!r}, which is not a file in its folder")
    real = Path(file).resolve()
    if not real.is_relative_to(folder):
        raise SpecError(f"{path} names {reference!r}, which lies outside its folder {folder}")
    if not real.is_file():
        raise SpecError(f"{path} names {reference!r}, which does not exist")
    _check_file(real)
    return target


def _check_prims(path: Path, layer: Sdf.Layer) -> None:
    """Refuse a layer that has too many bodies, or value clips, which USD reads from any folder."""
    waiting, bodies = list(layer.rootPrims), 0
    while waiting:
        prim = waiting.pop()
        if any(prim.HasInfo(key) for key in ("clips", "clipSets")):
            raise SpecError(f"{path}: {prim.path} has value clips, which are not read")
        schemas = prim.GetInfo("apiSchemas") if prim.HasInfo("apiSchemas") else None
        bodies += schemas is not None and "PhysicsRigidBodyAPI" in schemas.GetAppliedItems()
        if bodies > MAX_BODIES:
            raise SpecError(f"{path} has more than {MAX_BODIES} rigid bodies")
        waiting += prim.nameChildren
        for variants in prim.variantSets.values():
            waiting += [variant.primSpec for variant in variants.variants.values()]


def _line(error: Exception) -> str:
    text = plain_text(str(error), 1000)
    # The message begins with a location in the library's source.
    return text.partition(": '")[2][:240] or text[:240]
