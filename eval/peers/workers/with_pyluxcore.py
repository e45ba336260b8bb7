"""LuxCore as a peer, by the package ``pyluxcore``: its path tracer on the processor, with its Sobol sampler.

Its adaptive sampling skips pixels by chance, the more often the less noise its film estimates in them
(``sampler.sobol.adaptive.strength``, ``film.noiseestimation.*``).
"""

import time
from typing import Any

import numpy as np
import pyluxcore
from numpy.typing import NDArray

pyluxcore.Init(lambda line: None)

_POLL = 0.02  # seconds; looking merges the threads' films, which takes time from them


class Peer:
    """LuxCore with one scene (:class:`pmc_sampler.eval.peers.scene.Description`)."""

    version = f"LuxCore {pyluxcore.Version()}"
    settings = ("strength", "warmup", "step", "gamma")

    def __init__(self, description: dict[str, Any]) -> None:
        self._description = description
        self._scene = _scene(description)

    def render(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Render ``settings["samples"]`` samples a pixel on average with ``settings["seed"]``, from 1.

        ``strength``, 0 to 0.95, is how far sampling is adaptive (0: uniform). Then ``warmup`` samples a pixel come
        first, and noise is estimated again after each ``step``; ``gamma`` is that of the picture in which it is
        estimated. LuxCore looks now and then whether it has done enough, so that it may do more than was asked for.
        """
        config = pyluxcore.RenderConfig(_properties(_config(self._description, settings)), self._scene)
        session = pyluxcore.RenderSession(config)
        began = time.perf_counter()
        session.Start()
        while not session.HasDone():
            time.sleep(_POLL)
            session.UpdateStats()
        session.Stop()
        seconds = time.perf_counter() - began
        shape = (self._description["height"], self._description["width"])
        rgb = np.empty((*shape, 3), dtype=np.float32)
        counts = np.empty(shape, dtype=np.uint32)
        session.GetFilm().GetOutputFloat(pyluxcore.FilmOutputType.RGB, rgb)
        session.GetFilm().GetOutputUInt(pyluxcore.FilmOutputType.SAMPLECOUNT, counts)
        # The bottom row comes first.
        return {"rgb": rgb[::-1].copy(), "samples": counts[::-1].astype(np.float32), "seconds": seconds}


def _config(description: dict[str, Any], settings: dict[str, Any]) -> dict[str, Any]:
    strength = settings.get("strength", 0.0)
    gamma = settings.get("gamma", 1.0)
    return {
        "renderengine.type": "PATHCPU",
        "renderengine.seed": settings["seed"],
        "sampler.type": "SOBOL",
        "sampler.sobol.adaptive.strength": strength,
        "path.pathdepth.total": description["max_depth"],
        "path.pathdepth.diffuse": description["max_depth"],
        "path.pathdepth.glossy": description["max_depth"],
        "path.pathdepth.specular": description["max_depth"],
        "path.clamping.variance.maxvalue": 0.0,
        "film.width": description["width"],
        "film.height": description["height"],
        "film.filter.type": "NONE",
        "film.noiseestimation.warmup": settings.get("warmup", 32),
        "film.noiseestimation.step": settings.get("step", 32),
        "film.imagepipelines.0.0.type": "TONEMAP_LINEAR",
        "film.imagepipelines.0.0.scale": 1.0,
        "film.imagepipelines.0.1.type": "GAMMA_CORRECTION",
        "film.imagepipelines.0.1.value": gamma,
        "film.outputs.0.type": "RGB",
        "film.outputs.0.filename": "rgb.exr",
        "film.outputs.1.type": "SAMPLECOUNT",
        "film.outputs.1.filename": "samples.exr",
        "batch.haltspp": [settings["samples"], 0],
        "batch.halttime": 0,
    }


def _scene(description: dict[str, Any]) -> Any:
    made = pyluxcore.Scene()
    made.Parse(_properties(_camera(description)))
    made.Parse(_properties({"scene.materials.black.type": "matte", "scene.materials.black.kd": [0.0, 0.0, 0.0]}))
    for shape in description["shapes"]:
        made.DefineMesh(
            shape["name"],
            _tuples(shape["vertices"]),
            _tuples(shape["triangles"]),
            None if shape["normals"] is None else _tuples(shape["normals"]),
            None,
            None,
            None,
        )
        made.Parse(_properties(_object(shape)))
    return made


def _tuples(rows: NDArray[Any]) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rows.tolist()]


def _object(shape: dict[str, Any]) -> dict[str, Any]:
    key = shape["name"]
    material = f"scene.materials.{key}"
    made: dict[str, Any] = {f"scene.objects.{key}.shape": key, f"scene.objects.{key}.material": key}
    if shape["kind"] == "dielectric":
        return {
            **made,
            f"{material}.type": "glass",
            f"{material}.kr": [1.0, 1.0, 1.0],
            f"{material}.kt": [1.0, 1.0, 1.0],
            f"{material}.interiorior": shape["eta"],
            f"{material}.exteriorior": 1.0,
        }
    made |= {f"{material}-front.type": "matte", f"{material}-front.kd": list(shape["color"])}
    if shape["radiance"] is not None:
        made |= {
            f"{material}-front.emission": list(shape["radiance"]),
            f"{material}-front.emission.power": 0.0,
            f"{material}-front.emission.efficency": 0.0,
            f"{material}-front.emission.normalizebycolor": 0,
        }
    return {
        **made,
        f"{material}.type": "twosided",
        f"{material}.frontmaterial": f"{key}-front",
        f"{material}.backmaterial": f"{key}-front" if shape["two_sided"] else "black",
    }


def _camera(description: dict[str, Any]) -> dict[str, Any]:
    _, y, view = description["axes"]
    left, right, top, bottom = description["window"]
    row = (bottom - top) / description["height"]
    # With a field of view of 90 degrees along the shorter side its window is in tangents. Its pixels lie a row lower
    # than the window says.
    return {
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": description["origin"].tolist(),
        "scene.camera.lookat.target": (description["origin"] + view).tolist(),
        "scene.camera.up": (-y).tolist(),
        "scene.camera.fieldofview": 90.0,
        "scene.camera.screenwindow": [left, right, -bottom - row, -top - row],
        "scene.camera.cliphither": 1e-3,
        "scene.camera.clipyon": 1e4,
        "scene.camera.autovolume.enable": 0,
    }


def _properties(values: dict[str, Any]) -> Any:
    made = pyluxcore.Properties()
    for name, value in values.items():
        made.Set(pyluxcore.Property(name, value))
    return made
