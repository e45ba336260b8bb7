"""Blender's Cycles as a peer, by the package ``bpy``: the scene as Blender's objects, rendered without retouching.

Nothing of Cycles that trades bias for noise stays on: no denoising, no clamping, no filtering of glossy light, caustics
as they fall, every light however dim. What makes samples is left at its defaults: the light tree, the sampling
pattern, Russian roulette.
"""

import math
import time
from typing import Any

import bpy
import mathutils
import numpy as np

_LAYER = "layer"
_STEP = 16  # samples between two looks at what has converged, the first when more than min_samples + 1 are done


class Peer:
    """Cycles with one scene (:class:`pmc_sampler.eval.peers.scene.Description`)."""

    version = f"Blender {bpy.app.version_string}"
    settings = ("threshold", "min_samples")

    def __init__(self, description: dict[str, Any]) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        for shape in description["shapes"]:
            scene.collection.objects.link(bpy.data.objects.new(shape["name"], _mesh(shape)))
        scene.camera = _camera(description)
        scene.collection.objects.link(scene.camera)
        scene.world = None  # black
        _configure(scene, description)

    def render(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Render ``settings["samples"]`` samples a pixel with ``settings["seed"]``, 0 to 2^31 - 1, into an EXR file.

        With ``threshold``, Cycles' noise threshold, sampling is adaptive: ``samples`` is then the most that a pixel
        gets, a multiple of 16, and ``min_samples``, from 1, how many it gets before it may stop.
        """
        scene = bpy.context.scene
        scene.cycles.samples = settings["samples"]
        scene.cycles.seed = settings["seed"]
        scene.cycles.use_adaptive_sampling = "threshold" in settings
        first = settings["samples"]
        if "threshold" in settings:
            if settings["samples"] % _STEP or settings["min_samples"] < 1:
                raise ValueError(f"samples must be a multiple of {_STEP} and min_samples at least 1, to tell counts by")
            scene.cycles.adaptive_threshold = settings["threshold"]
            scene.cycles.adaptive_min_samples = settings["min_samples"]
            first = min(first, math.ceil((settings["min_samples"] + 2) / _STEP) * _STEP)
        scene.render.filepath = settings["file"]
        began = time.perf_counter()
        bpy.ops.render.render(write_still=True)
        return {
            "seconds": time.perf_counter() - began,
            "channels": {
                "rgb": [f"{_LAYER}.Combined.{channel}" for channel in "RGB"],
                "samples": f"{_LAYER}.Debug Sample Count.X",
            },
            # Its counts are shares of the largest it got to, which it keeps to itself.
            "count": {"most": settings["samples"], "step": _STEP, "first": first},
        }


def _configure(scene: Any, description: dict[str, Any]) -> None:
    image = scene.render
    image.engine = "CYCLES"
    image.resolution_x, image.resolution_y = description["width"], description["height"]
    image.resolution_percentage = 100
    image.use_persistent_data = True  # the scene is synchronised once
    image.use_compositing = image.use_sequencer = False
    if hasattr(image.image_settings, "media_type"):  # from Blender 5.0 on
        image.image_settings.media_type = "MULTI_LAYER_IMAGE"
    image.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    if hasattr(image.image_settings, "use_exr_interleave"):  # also from there on: else each pass is a part of its own
        image.image_settings.use_exr_interleave = True
    image.image_settings.color_depth = "32"
    scene.view_layers[0].name = _LAYER
    scene.view_layers[0].cycles.pass_debug_sample_count = True
    bounces = description["max_depth"] - 1
    wanted = {
        "device": "CPU",
        "use_denoising": False,
        "pixel_filter_type": "BOX",
        "sample_clamp_direct": 0.0,
        "sample_clamp_indirect": 0.0,
        "blur_glossy": 0.0,
        "caustics_reflective": True,
        "caustics_refractive": True,
        "light_sampling_threshold": 0.0,
        "max_bounces": bounces,
        "diffuse_bounces": bounces,
        "glossy_bounces": bounces,
        "transmission_bounces": bounces,
    }
    for name, value in wanted.items():
        setattr(scene.cycles, name, value)


def _camera(description: dict[str, Any]) -> Any:
    left, right, top, bottom = description["window"]
    wide = right - left
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    data.angle_x = 2.0 * math.atan(wide / 2.0)
    # Shifts are in units of the width; Blender's y goes up.
    data.shift_x = (left + right) / 2.0 / wide
    data.shift_y = -(top + bottom) / 2.0 / wide
    data.clip_start, data.clip_end = 1e-3, 1e4
    x, y, view = description["axes"]
    placed = np.eye(4)
    placed[:3] = np.stack([x, -y, -view, description["origin"]], axis=1)  # looks along -z, y up
    camera = bpy.data.objects.new("camera", data)
    camera.matrix_world = mathutils.Matrix(placed.tolist())
    return camera


def _mesh(shape: dict[str, Any]) -> Any:
    mesh = bpy.data.meshes.new(shape["name"])
    mesh.from_pydata(shape["vertices"].tolist(), [], shape["triangles"].tolist())
    if shape["normals"] is not None:
        mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), dtype=bool))
        mesh.normals_split_custom_set_from_vertices(shape["normals"].tolist())
    mesh.materials.append(_material(shape))
    mesh.update()
    return mesh


def _material(shape: dict[str, Any]) -> Any:
    material = bpy.data.materials.new(shape["name"])
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    surface = _glass(tree, shape) if shape["kind"] == "dielectric" else _diffuse(tree, shape)
    tree.links.new(surface, tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def _glass(tree: Any, shape: dict[str, Any]) -> Any:
    node = tree.nodes.new("ShaderNodeBsdfGlass")
    node.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    node.inputs["Roughness"].default_value = 0.0
    node.inputs["IOR"].default_value = shape["eta"]
    return node.outputs["BSDF"]


def _diffuse(tree: Any, shape: dict[str, Any]) -> Any:
    node = tree.nodes.new("ShaderNodeBsdfDiffuse")
    node.inputs["Color"].default_value = (*shape["color"], 1.0)
    node.inputs["Roughness"].default_value = 0.0
    front = node.outputs["BSDF"]
    if shape["radiance"] is not None:
        light = tree.nodes.new("ShaderNodeEmission")
        light.inputs["Color"].default_value = (*shape["radiance"], 1.0)
        light.inputs["Strength"].default_value = 1.0
        both = tree.nodes.new("ShaderNodeAddShader")
        tree.links.new(front, both.inputs[0])
        tree.links.new(light.outputs["Emission"], both.inputs[1])
        front = both.outputs["Shader"]
    if shape["two_sided"] and shape["radiance"] is None:
        return front
    # The back, of index 1, is black: no shader.
    sides = tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(tree.nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"], sides.inputs[0])
    tree.links.new(front, sides.inputs[1])
    return sides.outputs["Shader"]
