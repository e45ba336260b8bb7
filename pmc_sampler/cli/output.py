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

from pmc_sampler import Sampler, __version__

from .errors import CommandError
from .optional import load


class Output:
    """The files of one render; made only where they can be written, else :class:`CommandError`."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._images: ModuleType = load("pmc_sampler.eval.images", "writing images", "eval")
        self._options = options
        # The default's folder is where the user is, not where the scene is.
        given = options.output or Path(re.sub(r"\.(xml|gltf|glb|pov|ini)$", "", Path(options.scene).name) + ".exr")
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
            **{name: getattr(self._options, name) for name in ("scene", "renderer", "method", "sampler", "seed")},
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
        try:
            self._images.write_exr(self.exr, film.mean, layers, _metadata(sampler, summary))
            self._images.write_png(self.png, film.mean)
        except self._images.ImageError as error:
            raise CommandError(str(error), status=1) from error
        return {**summary, "output": str(self.exr), "preview": str(self.png)}


def report(summary: Mapping[str, Any], as_json: bool) -> None:
    """Print the summary to standard output, in words or as one JSON object."""
    if as_json:
        noise = summary["visible_noise"]
        print(json.dumps({**summary, "visible_noise": noise if math.isfinite(noise) else None}, indent=2))
        return
    seconds = summary["seconds"]
    print(
        f"{summary['scene']} at {summary['width']}x{summary['height']} by {summary['method']}: "
        f"{summary['spp']:.4g} samples per pixel in {seconds['total']:.2f} s "
        f"(renderer {seconds['renderer']:.2f} s, sampler {seconds['sampler']:.2f} s); "
        f"visible noise in {summary['visible_noise']:.1%} of the pixels."
    )
    if summary["rejected"]:
        print(f"{summary['rejected']} samples were rejected as not finite or negative.")
    print(f"{summary['output']} and {summary['preview']} are written.")


def _metadata(sampler: Sampler, summary: Mapping[str, Any]) -> dict[str, Any]:
    metadata = {f"pmc:{name}": value for name, value in summary.items() if name != "seconds"}
    metadata |= {f"pmc:seconds.{part}": value for part, value in summary["seconds"].items()}
    metadata["pmc:config"] = json.dumps(sampler.config.to_dict())
    metadata["pmc:budget"] = json.dumps(vars(sampler.budget))
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
