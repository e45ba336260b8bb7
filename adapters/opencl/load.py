"""From what a caller names to a `Scene`."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import Any

from .scene import Scene

__all__ = ["scene_of"]


def scene_of(scene: Any, size: tuple[int, int] | None = None) -> Scene:
    """The `Scene` meant by a built-in scene's name, a Mitsuba `.xml` file, a glTF file or a `Scene`.

    size: (width, height) of the film in pixels, in place of the scene's.

    Raises FileNotFoundError for a missing file, OSError for one that cannot be read, ValueError for one that cannot be
    rendered and TypeError for anything else. RuntimeError where the package that reads such files is missing.
    """
    if isinstance(scene, Scene):
        if size is not None and tuple(size) != (scene.camera.width, scene.camera.height):
            raise ValueError("a Scene keeps the size of its camera; change it there")
        return scene
    if not isinstance(scene, str | os.PathLike):
        raise TypeError(
            f"a scene is a built-in scene's name, an .xml, .gltf or .glb file, or a Scene, not {type(scene).__name__}"
        )
    file = Path(scene)
    if file.suffix.lower() not in ("", ".xml", ".gltf", ".glb"):
        raise ValueError(
            f"{scene} is no scene file that is known; read are .xml, .gltf and .glb, and built-in scenes by name"
        )
    reader = "gltf" if file.suffix.lower() in (".gltf", ".glb") else "mitsuba_scene"
    try:
        read = importlib.import_module(f".{reader}", __package__).read
    except ModuleNotFoundError as error:
        raise RuntimeError(
            f"reading {scene} needs the Python module {error.name}: pip install 'pmc-sampler[opencl]'"
        ) from error
    made: Scene = read(file, size)
    return made
