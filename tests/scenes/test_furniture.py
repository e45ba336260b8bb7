"""The meshes of the scene `room`: the files are what the script makes, and each is a sound solid or a sheet. Exact."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmc_sampler import scenes

pytestmark = pytest.mark.needs("trimesh", "scipy")


@pytest.fixture(scope="module")
def furniture() -> Any:
    from pmc_sampler.scenes import furniture

    return furniture


@pytest.fixture(scope="module")
def meshes(furniture: Any) -> dict[str, Any]:
    return {name: furniture.made(name) for name in furniture.MESHES}


def test_files_are_what_the_script_makes(furniture: Any, tmp_path: Path) -> None:
    """Written anew they have the same bytes, but for the header, where trimesh may name itself otherwise."""
    furniture.write(tmp_path / "new")
    names = sorted(path.name for path in furniture.FOLDER.glob("*.ply"))
    assert names == sorted(f"{name}.ply" for name in furniture.MESHES)
    assert names == sorted(path.name for path in (tmp_path / "new").iterdir())
    for name in names:
        old, new = ((folder / name).read_bytes() for folder in (furniture.FOLDER, tmp_path / "new"))
        assert old.partition(b"end_header\n")[2] == new.partition(b"end_header\n")[2] != b"", name


def test_the_scene_uses_all_of_them(meshes: dict[str, Any]) -> None:
    """With at least 50000 triangles, and as many, to 2 %, as the scene's comment says."""
    text = scenes.path("room").read_text(encoding="utf-8")
    files = [
        part.get("value") for part in ElementTree.fromstring(text).iter("string") if part.get("name") == "filename"
    ]
    assert set(files) == {f"room/{name}.ply" for name in meshes}
    triangles = sum(len(meshes[Path(str(file)).stem].faces) for file in files)
    assert triangles > 50_000
    assert abs(triangles / 85_000 - 1) < 0.02
    assert "About 85000 triangles" in " ".join(text.split())


def test_meshes_are_sound(furniture: Any, meshes: dict[str, Any]) -> None:
    """Each part of a solid is closed and faces outward; nothing is below the floor.

    The controls are a turned triangle and a hole.
    """
    for name, mesh in meshes.items():
        assert np.isfinite(mesh.vertices).all(), name
        assert mesh.area_faces.min() > 0, name
        assert mesh.is_winding_consistent, name
        assert mesh.bounds[0, 1] > -1e-3, name
        assert mesh.is_watertight == (name not in furniture.OPEN), name
        if mesh.is_watertight:
            assert all(part.volume > 0 for part in mesh.split()), name
    vase = meshes["vase"].copy()
    vase.faces[0] = vase.faces[0, ::-1]
    assert not vase.is_winding_consistent
    vase.update_faces(np.arange(len(vase.faces)) > 0)
    assert not vase.is_watertight
