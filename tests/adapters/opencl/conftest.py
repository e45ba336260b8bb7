"""Scenes made by hand for the OpenCL tracer, and kernels that call one of its functions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Array = npt.NDArray[Any]

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
# Counter-clockwise from outside.
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    np.uint32,
)  # fmt: skip


@pytest.fixture(scope="session")
def opencl(require: Callable[[str], Any]) -> Any:
    """The adapter."""
    require("pyopencl")
    import pmc_sampler.adapters.opencl

    return pmc_sampler.adapters.opencl


@pytest.fixture(scope="session")
def parts(opencl: Any) -> Any:
    """The module that defines what a scene holds."""
    from pmc_sampler.adapters.opencl import scene

    return scene


@pytest.fixture(scope="session")
def camera(parts: Any) -> Callable[..., Any]:
    """A function that gives a camera at `origin` that looks along -z, y up, 90 degrees wide."""

    def make(width: int = 16, height: int = 16, origin: Any = (0.0, 0.0, 4.0), reach: float = 1.0) -> Any:
        axes = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]], np.float32)
        window = (-reach, reach, -reach, reach)
        return parts.Camera(width, height, np.array(origin, np.float32), axes, window)

    return make


@pytest.fixture(scope="session")
def cube(parts: Any) -> Callable[..., Any]:
    """A function that gives a cube, [-1, 1]^3 times size; its fronts are outside, or inside."""

    def make(size: float = 1.0, material: int = 0, inside: bool = False, **more: Any) -> Any:
        faces = CUBE_FACES[:, ::-1].copy() if inside else CUBE_FACES
        return parts.Mesh(CUBE * np.float32(size), faces, material, **more)

    return make


@pytest.fixture(scope="session")
def white_sky(parts: Any) -> Any:
    """Radiance 1 from everywhere."""
    return parts.Environment(np.ones((1, 1, 3), np.float32))


@pytest.fixture(scope="session")
def call(opencl: Any) -> Callable[..., list[Array]]:
    """A function that compiles `text` after the tracer's kernels for a scene and runs its kernel `probe` over `count`
    work items; arrays of `inputs` go in, `outputs` are dtypes and widths of arrays that come out, in that order."""
    import pyopencl as cl
    from pmc_sampler.adapters.opencl import devices, program
    from pmc_sampler.adapters.opencl.tables import tables

    def run(
        scene: Any, text: str, count: int, inputs: list[Array], outputs: list[tuple[Any, int]], **macros: str
    ) -> list[Array]:
        context = cl.Context([devices.choose()])
        queue = cl.CommandQueue(context)
        compiled = tables(scene)
        kernel = program.build(context, {**compiled.macros, **macros}, "probe", text)
        made = [np.empty((count, width) if width > 1 else count, dtype) for dtype, width in outputs]
        flags = cl.mem_flags
        buffers = [
            cl.Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=np.ascontiguousarray(array))
            for array in inputs
        ] + [cl.Buffer(context, flags.WRITE_ONLY, array.nbytes) for array in made]
        kernel(queue, (count,), None, *buffers)
        for array, buffer in zip(made, buffers[len(inputs) :], strict=True):
            cl.enqueue_copy(queue, array, buffer)
        queue.finish()
        return made

    return run


@pytest.fixture(scope="session")
def changed() -> Callable[..., Any]:
    """`dataclasses.replace`."""
    return dataclasses.replace
