"""Image files: what is written is read again, exactly, and what cannot be is refused in a sentence."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from pmc_sampler.eval import images
from pmc_sampler.eval.display import display, srgb_decode

pytestmark = pytest.mark.needs("OpenImageIO")


@pytest.fixture
def picture() -> np.ndarray:
    return np.random.default_rng(7).gamma(0.5, 2.0, (9, 13, 3)).astype(np.float32)


def test_exr_keeps_every_layer_and_attribute(picture: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    layers = {
        "samples": np.arange(9 * 13).reshape(9, 13),
        "error": 0.1 * picture,
        "strategy": picture[::-1],
    }
    metadata = {"pmc:config": '{"radii": [1, 2]}', "pmc:seed": 2**63, "pmc:seconds.total": 1.25}
    images.write_exr(path, picture, layers, metadata)
    image = images.read(path)
    np.testing.assert_array_equal(image.rgb, picture)
    assert set(image.layers) == set(layers)
    for name, values in layers.items():
        np.testing.assert_array_equal(image.layers[name], values.astype(np.float32))
    assert image.metadata["pmc:config"] == metadata["pmc:config"]
    assert image.metadata["pmc:seed"] == str(2**63)
    assert image.metadata["pmc:seconds.total"] == 1.25


def test_exr_channels_have_the_names_tools_expect(picture: np.ndarray, tmp_path: Path) -> None:
    import OpenImageIO

    images.write_exr(tmp_path / "a.exr", picture, {"samples": picture[..., 0], "error": picture})
    spec = OpenImageIO.ImageBuf(str(tmp_path / "a.exr")).spec()
    assert set(spec.channelnames) == {"R", "G", "B", "samples", "error.R", "error.G", "error.B"}
    assert spec.channelnames[:3] == ("R", "G", "B")
    assert str(spec.format) == "float"


def test_png_is_the_tone_mapped_image(picture: np.ndarray, tmp_path: Path) -> None:
    images.write_png(tmp_path / "a.png", picture, exposure=0.5)
    shown = images.read(tmp_path / "a.png")
    expected = np.floor(display(picture, 0.5).astype(np.float64) * 255 + 0.5) / 255
    np.testing.assert_allclose(shown.rgb, srgb_decode(expected), atol=1e-6)


def test_images_of_other_programs_are_read(picture: np.ndarray, tmp_path: Path) -> None:
    import OpenImageIO

    OpenImageIO.ImageBuf(picture).write(str(tmp_path / "a.pfm"))
    np.testing.assert_array_equal(images.read(tmp_path / "a.pfm").rgb, picture)
    OpenImageIO.ImageBuf(np.ascontiguousarray(picture[..., :1])).write(str(tmp_path / "grey.pfm"))
    np.testing.assert_array_equal(images.read(tmp_path / "grey.pfm").rgb, np.repeat(picture[..., :1], 3, 2))
    OpenImageIO.ImageBuf(picture).write(str(tmp_path / "a.hdr"))
    # Radiance's RGBE shares one exponent among the channels: 8 bits of the largest.
    np.testing.assert_allclose(images.read(tmp_path / "a.hdr").rgb, picture, atol=float(picture.max()) / 128, rtol=0.02)


@pytest.mark.parametrize("broken", ["missing", "foreign", "truncated", "suffix"])
def test_unreadable_images_are_refused(broken: str, picture: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / ("a.txt" if broken == "suffix" else "a.exr")
    if broken == "foreign":
        path.write_text("no image")
    if broken == "truncated":
        images.write_exr(path, np.repeat(picture, 40, axis=0))
        path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(images.ImageError, match=str(path)):
        images.read(path)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.png", ".exr file"),
        ("none/a.exr", "does not exist"),
        ("file/a.exr", "file' of the output is a file; name another"),
        ("folder.exr", "is a folder"),
        ("/proc/a.exr", "no file can be written"),
    ],
)
def test_unwritable_output_is_seen_beforehand(name: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.exr").mkdir()
    before = sorted(os.listdir(tmp_path))
    with pytest.raises(images.ImageError, match=words):
        images.check_writable(tmp_path / name)
    assert sorted(os.listdir(tmp_path)) == before


def test_a_failed_write_leaves_the_old_file_and_nothing_else(picture: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    images.write_exr(path, picture)
    old = path.read_bytes()
    with pytest.raises(images.ImageError, match="layer 'samples'"):
        images.write_exr(path, picture, {"samples": np.zeros((2, 2))})
    with pytest.raises(images.ImageError, match="shape"):
        images.write_exr(path, picture[..., 0])
    assert path.read_bytes() == old
    images.check_writable(path)
    assert os.listdir(tmp_path) == ["a.exr"]


def test_a_missing_library_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "OpenImageIO", None)
    with pytest.raises(images.ImageError, match=r"pip install 'pmc-sampler\[eval\]'"):
        images.write_png(tmp_path / "a.png", np.zeros((2, 2, 3)))


def test_links_stay_and_pipes_are_refused(tmp_path: Path) -> None:
    image = np.full((2, 3, 3), 0.5, np.float32)
    (tmp_path / "a.exr").write_text("of before")
    (tmp_path / "link.exr").symlink_to("a.exr")
    images.write_exr(images.check_writable(tmp_path / "link.exr"), image)
    assert (tmp_path / "link.exr").is_symlink()
    np.testing.assert_array_equal(images.read(tmp_path / "a.exr").rgb, image)
    os.mkfifo(tmp_path / "pipe.exr")
    with pytest.raises(images.ImageError, match=r"pipe\.exr' is no regular file; name another"):
        images.check_writable(tmp_path / "pipe.exr")
    assert sorted(os.listdir(tmp_path)) == ["a.exr", "link.exr", "pipe.exr"]
