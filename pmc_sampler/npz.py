"""NumPy .npz archives as data: nothing in them is executed, and none takes more memory than the file has bytes."""

from __future__ import annotations

import io
import math
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Arrays = dict[str, npt.NDArray[Any]]
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def write(path: Path, arrays: Mapping[str, Any]) -> None:
    """Writes beside `path` and renames, so that an older file stays whole until the new one is on the disk.

    A process that is killed meanwhile leaves `PATH.*.part`. Raises OSError with the path where it cannot be written.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{str(path)!r} cannot be written: it is a folder; name a file")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{str(path)!r} cannot be written: there is no folder {str(path.parent)!r}")
    handle, name = tempfile.mkstemp(prefix=path.name + ".", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **arrays)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def read(path: Path) -> Arrays:
    """The arrays, read-only. Raises FileNotFoundError, OSError, or ValueError for what `write` did not write whole."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if any(member.compress_type != zipfile.ZIP_STORED for member in members):
                raise ValueError("it is compressed, and what is written here never is")
            if sum(member.file_size for member in members) > path.stat().st_size:
                raise ValueError("its parts are larger than the file")
            return {member.filename.removesuffix(".npy"): _array(archive.read(member)) for member in members}
    except (OSError, ValueError):
        raise
    except zipfile.BadZipFile as error:
        raise ValueError(f"it is no archive, or a part of it is damaged or missing ({error})") from error
    except Exception as error:  # of damaged headers zipfile and NumPy make errors of a dozen kinds
        raise ValueError(str(error) or type(error).__name__) from error


def _array(data: bytes) -> npt.NDArray[Any]:
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version not in _HEADERS:
        raise ValueError(f"a part is of version {version} of NumPy's format")
    shape, columns_first, dtype = _HEADERS[version](stream)
    start = stream.tell()
    if dtype.hasobject:
        raise ValueError("a part holds Python objects")
    if math.prod(shape) * dtype.itemsize != len(data) - start:
        raise ValueError(f"a part of {len(data) - start} bytes should hold {dtype} of shape {shape}")
    return np.ndarray(shape, dtype, data, start, order="F" if columns_first else "C")
