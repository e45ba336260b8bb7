"""What a render leaves: an EXR with layers and metadata, a PNG beside it, a summary."""

import argparse
import importlib
import json
import math
import platform
import re
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmc_sampler import Sampler, __version__

from .arguments import scene_path, scene_section
from .errors import CommandError
from .optional import load


class Output:
    """The files of one render; made only where they can be written, else :class:`CommandError`."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._images: ModuleType = load("pmc_sampler.eval.images", "writing images", "eval")
        self._options = options
        # The default's folder is where the user is, not where the scene is.
        name = re.sub(r"\.(xml|gltf|glb|pov|ini)$", "", scene_path(options.scene).name)
        if (section := scene_section(options.scene)) and "/" not in section:
            name += f"-{section}"
        given = options.output or Path(f"{name}.exr")
        try:
            self._images.require()
            self.exr: Path = self._images.check_writable(given)
        except self._images.ImageError as error:
            raise CommandError(str(error)) from error
        self.png = self.exr.with_suffix(".png")
        if self.png.is_dir():
            raise CommandError(f"{str(self.png)!r}, where the PNG would go, is a folder.")

    def write(self, sampler: Sampler, radiance: Any, seconds: Mapping[str, float], done: str | None) -> dict[str, Any]:
        """Write both files; returns the summary of the render."""
        summary = {
            **self._asked("seed"),
            **{name: getattr(sampler, name) for name in ("width", "height", "samples", "spp", "rejected")},
            "visible_noise": sampler.visible_noise,
            "seconds": dict(seconds),
            "done": done,
        }
        film = sampler.film
        layers = {"samples": film.samples, "error": film.standard_error, "strategy": film.strategy}
        if sampler.aovs:
            aovs = film.aovs
            layers |= {name: aovs[..., channel] for channel, name in enumerate(radiance.aov_names)}
        settings = {
            "config": sampler.config.resolved(sampler.width, sampler.height).to_dict(),
            "budget": vars(sampler.budget),
        }
        return self._save(film.mean, layers, summary, settings)

    def write_native(self, made: Any, settings: Mapping[str, Any], setup: float) -> dict[str, Any]:
        """Write what a renderer made by itself, with `settings` of its own; returns the summary.

        setup: seconds until it began.
        """
        height, width = made.mean.shape[:2]
        summary = {
            **self._asked(),
            "width": width,
            "height": height,
            "samples": made.samples,
            "spp": made.samples / (width * height),
            "rejected": 0,
            "visible_noise": math.nan,
            "seconds": {"setup": setup, "total": made.seconds, "renderer": made.seconds, "sampler": 0.0},
            "done": "native",
        }
        return self._save(made.mean, {}, summary, {"native": dict(settings)})

    def _asked(self, *more: str) -> dict[str, Any]:
        return {name: getattr(self._options, name) for name in ("scene", "renderer", "method", "sampler", *more)}

    def _save(
        self,
        image: NDArray[np.float32],
        layers: Mapping[str, Any],
        summary: Mapping[str, Any],
        settings: Mapping[str, Mapping[str, Any]],
    ) -> dict[str, Any]:
        given = {
            "device": self._options.device,
            "set": dict(self._options.settings),
            "own": self._options.own_options,
        }
        metadata = _metadata(summary, {**settings, "renderer_options": given})
        try:
            self._images.write_exr(self.exr, image, layers, metadata)
            self._images.write_png(self.png, image)
        except self._images.ImageError as error:
            raise CommandError(str(error), status=1) from error
        return {**summary, "output": str(self.exr), "preview": str(self.png)}


def report(summary: Mapping[str, Any], as_json: bool) -> None:
    """Print the summary to standard output, in words or as one JSON object."""
    noise = summary["visible_noise"]
    if as_json:
        print(json.dumps({**summary, "visible_noise": noise if math.isfinite(noise) else None}, indent=2))
        return
    seconds = summary["seconds"]
    print(
        f"{summary['scene']} at {summary['width']}x{summary['height']} by {summary['method']}: "
        f"{summary['spp']:.4g} samples per pixel in {seconds['total']:.2f} s "
        f"(renderer {seconds['renderer']:.2f} s, sampler {seconds['sampler']:.2f} s) "
        f"after {seconds['setup']:.2f} s of setup"
        + (f"; visible noise in {noise:.1%} of the pixels." if math.isfinite(noise) else ".")
    )
    if summary["rejected"]:
        print(f"{summary['rejected']} samples were rejected as not finite or negative.")
    print(f"{summary['output']} and {summary['preview']} are written.")


def _metadata(summary: Mapping[str, Any], settings: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    metadata = {f"pmc:{name}": value for name, value in summary.items() if name != "seconds"}
    metadata |= {f"pmc:seconds.{part}": value for part, value in summary["seconds"].items()}
    metadata |= {f"pmc:{name}": json.dumps(values) for name, values in settings.items()}
    metadata["pmc:versions"] = json.dumps(_versions(summary["renderer"]))
    metadata["Software"] = f"pmc_sampler {__version__}"
    return metadata


def _versions(renderer: str) -> dict[str, str]:
    versions = {
        "pmc_sampler": __version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
    }
    version = importlib.import_module("pmc_sampler.adapters").version(renderer)
    return {**versions, renderer: version} if version else versions
