"""Reader of untrusted .npz files."""

import io
import zipfile
import zlib
from math import prod
from pathlib import Path

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..errors import NeoWorldError
from .file_options import file_bounds
from .files import MIB, read_bytes

MAX_ARRAYS = 4096


def read_arrays(path: Path, error: type[NeoWorldError]) -> dict[str, NDArray]:
    """Read the arrays of an .npz file, checking all declared sizes before allocating memory.

    Args:
        path: the file.
        error: class of the error to raise.

    Raises:
        NeoWorldError: of the class `error`: the file cannot be read, contains something other than
            plain arrays, or unpacks to more than `files.max_file_mib`.
    """
    limit = file_bounds().max_file_mib * MIB
    try:
        data = read_bytes(Path(path), limit)
    except OSError as problem:
        raise error(f"cannot read {path}: {problem.strerror}") from None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            declared = sum(member.file_size for member in members)
            if len(members) > MAX_ARRAYS or declared > limit:
                raise error(
                    f"{path} unpacks to {declared / MIB:.0f} MiB in {len(members)} arrays; the "
                    f"limit is {limit // MIB} MiB in {MAX_ARRAYS} arrays (files.max_file_mib)"
                )
            return {m.filename.removesuffix(".npy"): _array(archive, m) for m in members}
    except (zipfile.BadZipFile, zlib.error, ValueError, EOFError, OSError, RuntimeError,
            NotImplementedError, SyntaxError, TypeError, OverflowError) as problem:  # fmt: skip
        raise error(f"{path} holds no readable arrays: {problem}") from None


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray:
    with archive.open(member) as stream:
        version = npy.read_magic(stream)  # pyright: ignore[reportArgumentType]
        headers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
        if version not in headers:
            raise ValueError(f"{member.filename} has the unsupported version {version}")
        shape, fortran, dtype = headers[version](stream)  # pyright: ignore[reportArgumentType]
        if dtype.hasobject:
            raise ValueError(f"{member.filename} holds Python objects")
        if len(shape) > 32 or any(n < 0 for n in shape):
            raise ValueError(f"{member.filename} has the invalid shape {shape}")
        size, available = prod(shape) * dtype.itemsize, member.file_size - stream.tell()
        if size > available:
            raise ValueError(f"{member.filename} declares {size} bytes but has {available}")
        array = np.frombuffer(stream.read(size), dtype, prod(shape)).copy()
    return array.reshape(shape[::-1]).T if fortran else array.reshape(shape)
