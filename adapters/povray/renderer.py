"""`PovRayRenderer`: any POV-Ray scene as a callable from a batch of samples to radiance."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..inputs import check_positive, check_size, check_whole
from . import check as checks
from . import images, native, numbers, options, program, source
from .camera import Camera
from .extract import extracting
from .prepare import sized, with_photons_saved, with_radiosity_saved
from .ray_mesh import mesh_camera
from .worker import Pool

__all__ = ["PovRayRenderer"]

_SIZE = (640, 480)
_DIRECT = (
    "exported to POV-Ray, the scene is lit directly and through clear glass only, so it is darker than in the other "
    "renderers: radiosity=true adds light between surfaces, photons=100000 caustics (--set on the command line)"
)
_BATCH = 1 << 17  # rays: a process for each part of a batch has to start and read the scene, whatever the part's size


class PovRayRenderer:
    """Renders a scene's samples with POV-Ray 3.7, through a camera that has a pixel for each of them.

    Called with a `Batch` it returns the radiance of each of its samples, shape (n, 3), float32, linear RGB. POV-Ray has
    no seed: where a scene's light is random, a sample's value depends on its place among the others, and those are
    shuffled. The same batch gives the same values, with the same `processes`; other batches have independent noise.

    A scene is a program: POV-Ray reads and writes files with the user's rights for it. It runs in a folder of its own,
    which is removed with all that was written there; only `sandbox` protects other files from a malicious scene.

    Parameters
    ----------
    scene
        A `.pov` file; an `.ini` file with `Input_File_Name`; or what is exported: a built-in scene's name, a Mitsuba
        `.xml` file, a glTF file or a `Scene` (see `export` for what POV-Ray makes of it).
    sampler
        "independent" or "sobol": for the places on the lens of a camera with focal blur. The rest is POV-Ray's.
    size
        (width, height) of the image in pixels, by default as `options` say, else 640x480.
    camera
        The camera, in place of the scene's: a `Camera`, or a mapping with "location", "right", "up" and "direction"
        (and what else a `Camera` has).
    options
        POV-Ray's: "Declare=NAME=VALUE", "Library_Path=FOLDER", "+LFOLDER", "+K0.5", "scene.ini", "scene.ini[section]".
    timeout
        Seconds that a run of POV-Ray may take, in each of its processes for its share of a batch.
    processes
        How many trace at once, by default one for each processor. The noise depends on it: give it for the same image
        on machines with other numbers of processors.
    check
        Whether the scene's camera is checked once by a small image, unless `camera` is given.
    radiosity, photons
        For scenes that are exported: see `export`.
    sandbox
        Whether POV-Ray runs under bubblewrap (`bwrap`): it may read all files, write to its own folder alone, and has
        no network.

    Attributes
    ----------
    camera
        The `Camera`.
    agreement
        How far its small image agrees with the scene's own, a `check.Agreement`; None if it was not checked.
    remark
        What the user should know of the image, a sentence; empty if there is nothing.
    clamped
        In how many samples so far radiance was infinite, beyond half floats, and is 65504 instead.
    seconds
        What was spent so far on writing "rays" and waiting for "povray"; "cpu" is the processor time of the latter,
        as far as it is known: not in a sandbox.

    Raises
    ------
    FileNotFoundError, OSError
        For a scene file that is missing or cannot be read.
    ValueError
        For a scene that POV-Ray cannot render, with its message, file and line; for one whose camera cannot be found;
        for an unknown sampler or option.
    TimeoutError
        If POV-Ray takes longer than `timeout` (which is an OSError).
    RuntimeError
        If there is no POV-Ray, or no sandbox where one is wanted, with what to install.
    """

    takes_batch = True

    def __init__(
        self,
        scene: Any,
        *,
        sampler: str = "independent",
        size: tuple[int, int] | None = None,
        camera: Camera | Mapping[str, Any] | None = None,
        options: Sequence[str] = (),
        timeout: float = program.TIMEOUT,
        processes: int | None = None,
        check: bool = True,
        radiosity: bool = False,
        photons: int = 0,
        sandbox: bool = False,
    ) -> None:
        if sampler not in numbers.SAMPLERS:
            raise ValueError(f"a sampler is {' or '.join(map(repr, numbers.SAMPLERS))}, not {sampler!r}")
        check_positive("timeout", timeout)
        if processes is not None:
            check_whole("processes", processes, 1, 1024)
        program.find()
        if sandbox:
            program.sandbox(Path.cwd())  # at once, if there is none
        self.sampler = sampler
        self._lock = threading.Lock()
        self._made = program.LastingFolder()
        folder = self._made.path
        self._filter: dict[str, Any] = {"filter": "box", "filter_radius": 0.5}
        self.remark = ""
        file, given, size = self._named(scene, size, options, radiosity, photons)
        self.width, self.height = size if size is not None else (given.width or _SIZE[0], given.height or _SIZE[1])
        check_size((self.width, self.height))
        self._source = source.of_file(file, given.libraries, given.switches, timeout, sandbox)
        self._own_camera = camera is None
        full, small = (self.width, self.height), checks.small(self.width, self.height)
        wanted = dict.fromkeys([full, *([small] if check else [])]) if self._own_camera else {}
        with contextlib.ExitStack() as stack:
            found = {size: stack.enter_context(extracting(self._source, *size)) for size in wanted}
            made = with_photons_saved(self._source, folder)  # meanwhile
            cameras = {size: camera_of() for size, camera_of in found.items()}
        made = with_radiosity_saved(made, self.width, self.height, folder)
        self.scene = file
        self.camera = cameras[full] if camera is None else _camera(camera)
        self.agreement: checks.Agreement | None = None
        if check and small in cameras:
            self.agreement = checks.check(made, cameras[small], *small)
        self.clamped = 0
        self._pool = Pool(sized(made, self.width, self.height, folder), processes or program.processors())

    @classmethod
    def probe(cls) -> str:
        """A line on the version; raises RuntimeError if there is no POV-Ray, with what to install."""
        return f"POV-Ray {program.version()} ({program.find()}), {program.processors()} processes"

    @classmethod
    def version(cls) -> str:
        """POV-Ray's version."""
        return f"POV-Ray {program.version()}"

    @property
    def filter(self) -> Mapping[str, Any]:
        """The settings of a `Config` for the reconstruction filter: a box, since POV-Ray scenes name none."""
        return self._filter

    @property
    def batching(self) -> Mapping[str, int]:
        """The settings of a `Config` that suit POV-Ray: large batches.

        But of two samples a pixel at most, for a population that moves once in many samples learns little.
        """
        pixels = self.width * self.height
        return {"batch": max(pixels // 4, min(_BATCH, 2 * pixels))}

    @property
    def processes(self) -> int:
        """How many processes trace at once."""
        return self._pool.processes

    @property
    def seconds(self) -> Mapping[str, float]:
        """What was spent so far, by what on."""
        return self._pool.seconds

    def __repr__(self) -> str:
        return f"PovRayRenderer({self.scene}, {self.width}x{self.height}, {self.camera.kind}, {self.sampler})"

    def native(
        self,
        *,
        antialiasing: int = 2,
        depth: int = 3,
        threshold: float = 0.3,
        jitter: bool = True,
        threads: int | None = None,
    ) -> native.Native:
        """The image by POV-Ray's own anti-aliasing, with the same camera and options; see `native.render`.

        Photons and radiosity are computed within it, as POV-Ray does by itself. Raises as `native.render`, and
        ValueError where a camera with a lens was given.
        """
        return native.render(
            self._source,
            (self.width, self.height),
            antialiasing=antialiasing,
            depth=depth,
            threshold=threshold,
            jitter=jitter,
            threads=threads,
            camera="" if self._own_camera else self.camera.statement,
        )

    def close(self) -> None:
        """Ends the processes that wait for the next batch; happens by itself when the object goes, or Python ends."""
        self._pool.close()
        self._made.close()

    def __call__(self, batch: Any) -> NDArray[np.float32]:
        """The radiance of each sample of `batch`, shape (n, 3), float32, linear RGB.

        Raises TypeError for what is no batch, and as the class does if POV-Ray fails; no process is left then.
        """
        try:
            positions, scramble, index, number = batch.positions, batch.scramble, batch.index, batch.number
        except AttributeError:
            raise TypeError(
                "a PovRayRenderer is called with a Batch (positions, scramble and index of each sample, number), "
                f"not with {type(batch).__name__}"
            ) from None
        out = np.zeros((len(positions), 3), np.float32)
        with self._lock:
            order = numbers.order(np.asarray(scramble, np.uint32), np.asarray(index, np.uint32), int(number))
            order = order[self.camera.sees(self.width, self.height, positions[order])]
            if len(order) == 0:
                return out
            positions = np.asarray(positions, np.float64)[order]
            lens = numbers.lens(self.sampler, scramble[order], index[order]) if self.camera.has_lens else None

            def rays(first: int, last: int) -> str:
                through = None if lens is None else lens[first:last]
                return mesh_camera(self.camera, self.width, self.height, positions[first:last], through)

            radiance = self._pool.trace(len(order), rays)
            self.clamped += images.clamp(radiance)
            out[order] = radiance
        return out

    def _named(
        self, scene: Any, size: tuple[int, int] | None, given: Sequence[str], radiosity: bool, photons: int
    ) -> tuple[Path, options.Options, tuple[int, int] | None]:
        """The scene's file, its options and the size, where one is settled."""
        if isinstance(scene, str | os.PathLike):
            file = Path(scene)
            ini = file.suffix.lower() == ".ini" or os.fspath(scene).endswith("]")
            own = ini or file.suffix.lower() in (".pov", ".inc", ".sdl")
            if own and (radiosity or photons):
                raise ValueError(
                    f"radiosity and photons are options for scenes that are exported to POV-Ray; {scene} is POV-Ray's "
                    "own: turn them on in its global_settings"
                )
            if ini:
                read = options.read([os.fspath(scene), *given])
                if read.scene is None:
                    raise ValueError(f"the INI file {scene} names no scene (Input_File_Name=SCENE.pov)")
                return read.scene, read, size
            if own:
                return file, options.read(given), size
        from ..opencl.load import scene_of  # not above: it needs what our OpenCL tracer needs
        from .export import export

        made = scene_of(scene, size)
        self._filter = dict(made.filter)
        file = export(made, self._made.path / "exported", radiosity=radiosity, photons=photons)
        if not (radiosity or photons):
            self.remark = _DIRECT
        return file, options.read(given), (made.camera.width, made.camera.height)


def _camera(given: Camera | Mapping[str, Any]) -> Camera:
    if isinstance(given, Camera):
        return given
    try:
        return Camera(**{"kind": "perspective", **given})
    except TypeError as error:
        raise ValueError(
            "a camera is a Camera, or a mapping with location, right, up, direction and what else a Camera has "
            f"({str(error).partition(') ')[2] or error})"
        ) from None
