"""What is done once for all batches of a scene: photons and radiosity, which each process then loads."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from .images import whole
from .program import private_folder
from .scene_text import has_radiosity, with_photons
from .sdl import changed, texts, with_size
from .source import Source, image

__all__ = ["sized", "with_photons_saved", "with_radiosity_saved"]

_PHOTONS, _RADIOSITY = "pmc_photons.ph", "pmc_radiosity.rca"


def with_photons_saved(source: Source, folder: Path) -> Source:
    """The scene with its photons in a file in `folder`; as it is, if it has none.

    They are found where the scene's text, or a file that it includes, has `global_settings { photons { ... } }` and
    names no file for them; otherwise each process shoots them again. With one thread they are the same in every run.

    Raises as `Source.run`.
    """
    with private_folder() as place, private_folder() as includes:
        saving = changed(source, lambda text: with_photons(text, f'save_file "{_PHOTONS}"'), includes)
        if saving == source:
            return source
        rendering = saving.start(place, ("+W1", "+H1"))  # which begins once they are saved
        rendering.wait(source.timeout, lambda: whole(image(place))).check(str(source.file))
        if not _kept(place / _PHOTONS, folder / _PHOTONS):
            return source
    includes = folder / "photons"
    includes.mkdir()
    loading = changed(source, lambda text: with_photons(text, f'load_file "{_PHOTONS}"'), includes)
    return dataclasses.replace(loading, files=(*loading.files, (_PHOTONS, folder / _PHOTONS)))


def with_radiosity_saved(source: Source, width: int, height: int, folder: Path) -> Source:
    """The scene with the radiosity of an image of `width` by `height` pixels in a file in `folder`.

    It is as it was if neither its text nor a file that it includes has `global_settings { radiosity { ... } }`.

    Raises as `Source.run`.
    """
    if not any(map(has_radiosity, texts(source))):
        return source
    with private_folder() as place:
        source.run(place, (f"+W{width}", f"+H{height}", "+RFO", f"+RF{_RADIOSITY}"))
        if not _kept(place / _RADIOSITY, folder / _RADIOSITY):
            return source
    return dataclasses.replace(
        source,
        switches=(*source.switches, "+RFI", f"+RF{_RADIOSITY}"),
        files=(*source.files, (_RADIOSITY, folder / _RADIOSITY)),
    )


def sized(source: Source, width: int, height: int, folder: Path) -> Source:
    """The scene with `image_width` and `image_height` those of the picture, for batches are images of other sizes.

    Included files that change are written below `folder`.
    """
    includes = folder / f"{width}x{height}"
    includes.mkdir(exist_ok=True)
    return changed(source, lambda text: with_size(text, width, height), includes)


def _kept(made: Path, place: Path) -> bool:
    """Moves a file there, if POV-Ray has made it."""
    if not made.is_file() or made.stat().st_size == 0:
        return False
    made.replace(place)
    return True
