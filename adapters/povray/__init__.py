"""An unmodified POV-Ray 3.7 as a renderer of the sampler's batches."""

from __future__ import annotations

try:
    import OpenImageIO as _OpenImageIO  # noqa: F401
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"OpenImageIO is not installed (no module {error.name!r}), with which POV-Ray's images are read; "
        "`pip install 'pmc-sampler[povray]'`",
        name=error.name,
    ) from error

from .camera import Camera
from .renderer import PovRayRenderer

__all__ = ["Camera", "PovRayRenderer"]
