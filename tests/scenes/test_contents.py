"""The digest of a scene file and of what it names."""

from pathlib import Path

import pytest

from pmc_sampler import scenes

SCENES = {
    "a.xml": b'<string name="filename" value="parts/used.bin"/>',
    "a.gltf": b'{"buffers": [{"uri": "parts/used.bin"}]}',
    "a.pov": b'#include "b.inc"',
    "a.ini": b"Width=64\nInput_File_Name = parts/used.bin ; the scene\n",
}


@pytest.mark.parametrize("name", SCENES)
def test_what_is_named_counts(name: str, tmp_path: Path) -> None:
    """In its turn, too, and in a circle; what nobody names does not."""
    (tmp_path / "parts").mkdir()
    scene, used, unused = tmp_path / name, tmp_path / "parts" / "used.bin", tmp_path / "parts" / "unused.bin"
    scene.write_bytes(SCENES[name])
    (tmp_path / "b.inc").write_bytes(b'#include "a.pov" image_map { png "parts/used.bin" } "' + b"x" * 999 + b'"')
    digests = [scenes.digest(scene)]
    for file in (used, unused, scene):
        file.write_bytes(file.read_bytes() + b" " if file.exists() else b"1")
        digests.append(scenes.digest(scene))
    assert digests[1] == digests[2]
    assert len({digests[0], digests[1], digests[3]}) == 3


def test_no_scene(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none\.xml"):
        scenes.digest(tmp_path / "none.xml")
