"""Arrays in .npz files from outside."""

import io
import zipfile
import zlib
from math import prod
from pathlib import Path

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..errors import NeoWorldError
from .bounds import bounds_of_files
from .files import MIB, read_bytes

MAX_ARRAYS = 4096


def read_arrays(path: Path, error: type[NeoWorldError]) -> dict[str, NDArray]:
    """Read the arrays of an .npz file; what it claims is checked before memory is taken.

    Args:
        path: the file.
        error: class of the error to raise.

    Raises:
        NeoWorldError: of the class `error`: the file cannot be read, holds no plain arrays, or
            unpacks to more than `files.max_array_mib`.
    """
    most = bounds_of_files().max_array_mib * MIB
    try:
        data = read_bytes(Path(path), most)
    except OSError as problem:
        raise error(f"cannot read {path}: {problem.strerror}") from None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            claimed = sum(member.file_size for member in members)
            if len(members) > MAX_ARRAYS or claimed > most:
                raise error(
                    f"{path} unpacks to {claimed / MIB:.0f} MiB in {len(members)} arrays; at most "
                    f"{most // MIB} in {MAX_ARRAYS} are read (files.max_array_mib)"
                )
            return {m.filename.removesuffix(".npy"): _array(archive, m) for m in members}
    except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, OSError, RuntimeError,
            NotImplementedError, SyntaxError, TypeError, OverflowError) as problem:  # fmt: skip
        raise error(f"{path} holds no arrays that can be read: {problem}") from None


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray:
    with archive.open(member) as stream:
        version = npy.read_magic(stream)  # pyright: ignore[reportArgumentType]
        headers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
        if version not in headers:
            raise ValueError(f"{member.filename} is of version {version}")
        shape, fortran, dtype = headers[version](stream)  # pyright: ignore[reportArgumentType]
        if dtype.hasobject:
            raise ValueError(f"{member.filename} holds Python objects")
        if len(shape) > 32 or any(n < 0 for n in shape):
            raise ValueError(f"{member.filename} has the shape {shape}")
        size, left = prod(shape) * dtype.itemsize, member.file_size - stream.tell()
        if size > left:
            raise ValueError(f"{member.filename} claims {size} bytes and has {left}")
        array = np.frombuffer(stream.read(size), dtype, prod(shape)).copy()
    return array.reshape(shape[::-1]).T if fortran else array.reshape(shape)
