"""The checkpoint file: an .npz archive of byte blocks and a JSON header. It is data: nothing in it is executed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pmc_sampler import npz

FORMAT = "pmc_sampler checkpoint"
VERSION = 6
Blocks = dict[str, npt.NDArray[np.uint8]]


def write(path: Path, header: Mapping[str, Any], blocks: Mapping[str, npt.NDArray[np.uint8]]) -> None:
    """Writes as `npz.write`, and raises as that does."""
    text = json.dumps({"format": FORMAT, "version": VERSION, **header}).encode()
    npz.write(path, {"header": np.frombuffer(text, np.uint8), **blocks})


def read(path: Path) -> tuple[dict[str, Any], Blocks]:
    """Header and blocks. Raises FileNotFoundError, or ValueError for what is not a whole checkpoint of this version."""
    if not path.is_file():
        raise FileNotFoundError(f"no checkpoint at {str(path)!r}: expected a file that Sampler.save wrote")
    try:
        blocks = npz.read(path)
        header = json.loads(blocks.pop("header").tobytes())
        if header.get("format") != FORMAT:
            raise ValueError("its header is not a checkpoint's")
        if any(block.dtype != np.uint8 or block.ndim != 1 for block in blocks.values()):
            raise ValueError("a block does not hold bytes")
    except (OSError, ValueError, KeyError, AttributeError, RecursionError) as error:
        raise ValueError(f"{str(path)!r} is no whole pmc_sampler checkpoint: {error}") from error
    if header.get("version") != VERSION:
        raise ValueError(
            f"{str(path)!r} is a checkpoint of version {header.get('version')}: "
            f"this version of pmc_sampler reads {VERSION}"
        )
    return header, blocks
