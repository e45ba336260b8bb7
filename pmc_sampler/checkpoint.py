"""The checkpoint file: a NumPy .npz archive of byte blocks and a JSON header. It is data: nothing in it is executed."""

from __future__ import annotations

import json
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

FORMAT = "pmc_sampler checkpoint"
VERSION = 1
Blocks = dict[str, npt.NDArray[np.uint8]]


def write(path: Path, header: Mapping[str, Any], blocks: Mapping[str, npt.NDArray[np.uint8]]) -> None:
    """Writes beside `path` and renames, so that an older checkpoint stays whole until the new one is.

    Raises OSError with the path where it cannot be written.
    """
    text = json.dumps({"format": FORMAT, "version": VERSION, **header}).encode()
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{str(path)!r} cannot be written: there is no folder {str(path.parent)!r}")
    handle, name = tempfile.mkstemp(prefix=path.name + ".", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            arrays: dict[str, Any] = {"header": np.frombuffer(text, np.uint8), **blocks}
            np.savez(file, **arrays)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def read(path: Path) -> tuple[dict[str, Any], Blocks]:
    """Header and blocks. Raises FileNotFoundError, or ValueError for what is not a whole checkpoint of this version."""
    if not path.is_file():
        raise FileNotFoundError(f"no checkpoint at {str(path)!r}: expected a file that Sampler.save wrote")
    try:
        if not zipfile.is_zipfile(path):
            raise ValueError("it is no archive, or its end is missing")
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            blocks = {name: archive[name] for name in archive.files}
        header = json.loads(blocks.pop("header").tobytes())
        if header.get("format") != FORMAT:
            raise ValueError("its header is not a checkpoint's")
        if any(block.dtype != np.uint8 or block.ndim != 1 for block in blocks.values()):
            raise ValueError("a block does not hold bytes")
    except Exception as error:  # of what is no archive, zipfile, NumPy and json make errors of a dozen kinds
        raise ValueError(f"{str(path)!r} is no whole pmc_sampler checkpoint: {error}") from error
    if header.get("version") != VERSION:
        raise ValueError(
            f"{str(path)!r} is a checkpoint of version {header.get('version')}: "
            f"this version of pmc_sampler reads {VERSION}"
        )
    return header, blocks
