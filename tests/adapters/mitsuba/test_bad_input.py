"""What cannot serve is refused with one sentence that says what came and what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("mitsuba")


OBJ = (
    '<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"/>'
    '<shape type="obj"><string name="filename" value="meshes/triangle.obj"/></shape></scene>'
)


def renderer(*arguments: Any, **options: Any) -> Any:
    from pmc_sampler.adapters.mitsuba import MitsubaRenderer

    return MitsubaRenderer(*arguments, **options)


@pytest.mark.parametrize(
    ("scene", "error", "message"),
    [
        ("cornel-box", ValueError, r"no built-in scene is called 'cornel-box'.*did you mean 'cornell-box'"),
        ("nowhere/scene.xml", FileNotFoundError, r"there is no scene file nowhere/scene\.xml"),
        ("scene.pov", ValueError, r"Mitsuba reads scenes from \.xml files and scene\.pov is none"),
        (7, TypeError, r"a scene is a mi\.Scene, .* not int"),
        ({"type": "sphere"}, ValueError, r"has \"type\": \"scene\"; this one has 'sphere'"),
        ({"type": "scene", "a": {"type": "sfere"}}, ValueError, r"cannot load the scene dictionary: .*sfere"),
    ],
)
def test_scenes_that_are_none(scene: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        renderer(scene)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "No document element"),
        (b"\x00\x01\xff", "No document element"),
        (b'<scene version="3.0.0"><shape type="sphere"></scene>', "tags mismatch"),
        (b'<scene version="3.0.0"><shape type="sfere"/></scene>', 'of type "sfere"'),
        (b'<scene version="3.0.0"><ref id="absent"/></scene>', "absent"),
        (OBJ.replace("meshes/triangle", "gone").encode(), "gone.obj"),
    ],
)
def test_files_that_do_not_load(tmp_path: Path, content: bytes, message: str) -> None:
    file = tmp_path / "scene.xml"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        renderer(file)
    assert str(caught.value).startswith(f"Mitsuba cannot load {file}: ")
    assert "\n" not in str(caught.value)
    assert ".cpp" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "folder.xml").mkdir()
    with pytest.raises(OSError, match=r"folder\.xml cannot be read: "):
        renderer(tmp_path / "folder.xml")


def test_files_beside_the_scene_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes are relative to the scene's file, wherever the process runs, and the search path is left as it
    was."""
    import mitsuba as mi

    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "triangle.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "scene.xml").write_text(OBJ)
    before = str(mi.file_resolver())
    assert len(renderer(tmp_path / "scene.xml").scene.shapes()) == 1
    assert str(mi.file_resolver()) == before


def test_scenes_that_lack_a_part(small_scene: Any) -> None:
    with pytest.raises(ValueError, match="has no sensor, so there is no sensor 0"):
        renderer({"type": "scene", "integrator": {"type": "path"}})
    with pytest.raises(ValueError, match="names no integrator; add one"):
        renderer(small_scene(integrator=None))


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"sensor": 1}, ValueError, r"has one sensor, number 0, so there is no sensor 1"),
        ({"sensor": -1}, ValueError, r"there is no sensor -1"),
        ({"sensor": "main"}, TypeError, r"a sensor is the index .* not 'main'"),
        ({"integrator": "ptracer"}, ValueError, r"does not return radiance for a ray"),
        ({"integrator": "pathh"}, ValueError, r"cannot load the integrator 'pathh'"),
        (
            {"integrator": 3},
            TypeError,
            r"^an integrator is a plugin's name, .* or a mi\.Integrator of the variant \w+, not int$",
        ),
        ({"sampler": "halton"}, ValueError, r"a sampler is 'sobol' or 'independent', not 'halton'"),
        ({"variant": "scalar_rgb"}, ValueError, r"scalar variants follow one ray at a time"),
        ({"variant": "llvm_ad_mono_polarized"}, ValueError, r"polarised variants carry Stokes vectors"),
        ({"variant": "metal_rgb"}, ValueError, r"no such variant; use one of llvm_ad_rgb"),
        (
            {"size": (0, 10)},
            ValueError,
            r"a size is \(width, height\) in whole pixels, at least 1 by 1, not \(0, 10\)",
        ),
        ({"size": (10.5, 10)}, ValueError, r"a size is"),
        ({"size": 10}, ValueError, r"a size is"),
    ],
)
def test_options_that_cannot_serve(options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        renderer("cornell-box", **options)


def test_films_of_spectral_bands(small_scene: Any) -> None:
    band = {"type": "irregular", "wavelengths": "400, 500, 600", "values": "0, 1, 0"}
    scene = small_scene()
    scene["sensor"]["film"] = {"type": "specfilm", "width": 8, "height": 8, "band": band}
    with pytest.raises(ValueError, match="does not record RGB; use an hdrfilm"):
        renderer(scene, variant="llvm_ad_spectral")


def test_scenes_of_other_variants(mi: Any, small_scene: Any) -> None:
    scene = mi.load_dict(small_scene())
    with pytest.raises(
        ValueError, match=r"loaded in the variant 'llvm_ad_rgb' .* cannot be rendered in 'llvm_ad_mono'"
    ):
        renderer(scene, variant="llvm_ad_mono")
    with mi.util.variant_context("scalar_rgb"):
        scalar = mi.load_dict(small_scene())
    with pytest.raises(ValueError, match="scalar variants follow one ray at a time"):
        renderer(scalar)


def test_integrators_of_other_variants(mi: Any, small_scene: Any) -> None:
    integrator = mi.load_dict({"type": "path"})
    with pytest.raises(TypeError, match=r"a mi\.Integrator of the variant llvm_ad_mono, not \w+Integrator$"):
        renderer(small_scene(film={"pixel_format": "luminance"}), integrator=integrator, variant="llvm_ad_mono")


def test_an_active_scalar_variant_is_no_obstacle(mi: Any) -> None:
    """Other parts of a program may parse scenes in a scalar variant; it stays active for them, even if the same one was
    left active here before."""
    from pmc_sampler.adapters.mitsuba import variants

    variants._ours.variant = "scalar_rgb"
    with mi.util.variant_context("scalar_rgb"):
        r = renderer("diffuse", size=(8, 6))
        assert mi.variant() == "scalar_rgb"
    assert r.variant in ("llvm_ad_rgb", "cuda_ad_rgb")


def test_the_variant_stays_where_no_user_chose_another(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """To change it for each batch costs tens of milliseconds."""
    from pmc_sampler.adapters.mitsuba import variants

    current, changes = [None], []

    def change(name: str) -> None:
        current[0] = name
        changes.append(name)

    monkeypatch.setattr(variants.mi, "variant", lambda: current[0])
    monkeypatch.setattr(variants.mi, "set_variant", change)
    monkeypatch.setattr(variants, "_ours", variants._Ours())
    with variants.active("scalar_rgb"):  # a scene is read
        pass
    for _ in range(3):  # batches are rendered
        with variants.active("llvm_ad_rgb"), variants.active("scalar_rgb"):
            pass
    assert changes == ["scalar_rgb", "llvm_ad_rgb"] + 3 * ["scalar_rgb", "llvm_ad_rgb"]
    changes.clear()
    current[0] = "llvm_ad_mono"  # the user's choice
    for _ in range(2):
        with variants.active("llvm_ad_rgb"):
            assert current == ["llvm_ad_rgb"]
    assert changes == 2 * ["llvm_ad_rgb", "llvm_ad_mono"]


def test_no_cuda(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from pmc_sampler.adapters.mitsuba import variants

    monkeypatch.setattr(variants, "_cuda", lambda: False)
    with pytest.raises(
        RuntimeError,
        match=r"cuda_ad_rgb' cannot run here: Dr\.Jit finds no CUDA device; install NVIDIA's driver",
    ):
        renderer("cornell-box", variant="cuda_ad_rgb")


def test_positions_alone_are_no_batch(small_scene: Any) -> None:
    with pytest.raises(TypeError, match=r"is called with a Batch .* not with ndarray"):
        renderer(small_scene())(np.zeros((4, 2), np.float32))
