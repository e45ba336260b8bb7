"""Whether the tracer and Mitsuba make the same image.

Each comparison is a family of Welch's t-tests over 16 seeds, on the mean of the image and of each 16x16-pixel tile,
corrected by Sidak's formula; a right tracer fails one in 1000 comparisons. The negative control is glass whose index of
refraction is off by 2 %.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.needs("pyopencl", "mitsuba", "OpenImageIO", "scipy")

FALSE_ALARMS = 1e-3
SIZE = (64, 48)


@pytest.fixture(scope="module")
def stacks(opencl: Any, batch_of: Any, image_from: Any) -> Callable[..., list[Any]]:
    """A function from a scene to both tracers' images, (16, h, w, 3) each. `other`: Mitsuba's scene."""
    from pmc_sampler.adapters.mitsuba import MitsubaRenderer

    def render(scene: Any, other: Any = None, spp: int = 32, size: tuple[int, int] = SIZE, **options: Any) -> list[Any]:
        pair = (
            opencl.OpenCLRenderer(scene, "independent", size=size, **options),
            MitsubaRenderer(other or scene, sampler="independent", size=size),
        )
        return [
            np.array([image_from(renderer(batch_of(*size, spp, 1000 * k + seed)), *size) for seed in range(16)])
            for k, renderer in enumerate(pair)
        ]

    return render


@pytest.fixture(scope="module")
def p_of(stacks: Any, p_value_of: Any) -> Callable[..., float]:
    """A function from a scene to the p-value of both tracers' images having one mean."""
    return lambda *arguments, **options: float(p_value_of(*stacks(*arguments, **options)))


@pytest.mark.parametrize(
    ("scene", "spp"),
    [
        ("cornell-box", 48),
        ("cornell-box-mirrors", 48),
        ("diffuse", 32),
        ("materials", 48),
        ("room", 8),
        ("thin-lens", 32),
    ],
)
def test_built_in_scenes(p_of: Any, scene: str, spp: int) -> None:
    assert p_of(scene, spp=spp) > FALSE_ALARMS


def test_through_the_hierarchy(p_of: Any) -> None:
    """The boxes have so few primitives that rays meet them one by one unless told otherwise."""
    assert p_of("cornell-box", hierarchy=True) > FALSE_ALARMS


PARTS = {
    "environment map": """
        <emitter type="envmap"><string name="filename" value="sky.exr"/>
            <transform name="to_world"><rotate x="1" angle="35"/><rotate y="1" angle="20"/></transform></emitter>
        <shape type="sphere"><bsdf type="roughconductor"><string name="distribution" value="ggx"/>
            <float name="alpha" value="0.2"/><string name="material" value="Au"/></bsdf></shape>""",
    "point, direction and lamp ball": """
        <emitter type="point"><point name="position" x="2" y="2" z="2"/>
            <rgb name="intensity" value="5, 4, 3"/></emitter>
        <emitter type="directional"><vector name="direction" x="-1" y="-2" z="-1"/>
            <rgb name="irradiance" value="0.5, 1, 1.5"/></emitter>
        <shape type="sphere"><point name="center" x="1.2" y="1.2" z="0.5"/><float name="radius" value="0.3"/>
            <emitter type="area"><rgb name="radiance" value="6, 5, 4"/></emitter></shape>
        <shape type="sphere"><bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.7, 0.2, 0.1"/>
            <boolean name="nonlinear" value="true"/></bsdf></shape>""",
    "inside a lamp": """
        <shape type="sphere"><float name="radius" value="8"/><boolean name="flip_normals" value="true"/>
            <emitter type="area"><rgb name="radiance" value="1, 0.8, 0.6"/></emitter></shape>
        <shape type="cube"><transform name="to_world"><rotate y="1" angle="30"/><scale value="0.6"/></transform>
            <bsdf type="roughdielectric"><string name="distribution" value="ggx"/>
            <float name="alpha" value="0.3"/></bsdf></shape>""",
    "textures": """
        <emitter type="constant"><rgb name="radiance" value="0.2, 0.3, 0.4"/></emitter>
        <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="90"/><scale value="0.6"/>
            <translate y="1.8"/></transform>
            <emitter type="area"><texture name="radiance" type="bitmap"><string name="filename" value="lamp.exr"/>
            </texture></emitter></shape>
        <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-40"/></transform>
            <bsdf type="twosided"><bsdf type="normalmap"><boolean name="use_shadowing_function" value="false"/>
            <boolean name="flip_invalid_normals" value="false"/>
            <texture type="bitmap" name="normalmap"><boolean name="raw" value="true"/>
            <string name="filename" value="bumps.exr"/></texture>
            <bsdf type="diffuse"><texture name="reflectance" type="bitmap"><string name="filename" value="tiles.exr"/>
            </texture></bsdf></bsdf></bsdf></shape>
        <shape type="rectangle"><transform name="to_world"><scale value="0.4"/><translate x="0.5" z="0.8"/></transform>
            <bsdf type="mask"><texture name="opacity" type="checkerboard"><rgb name="color0" value="0.1"/>
            <rgb name="color1" value="0.9"/></texture>
            <bsdf type="twosided"><bsdf type="diffuse"/></bsdf></bsdf></shape>""",
}


HEAD = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="8"/></integrator>
    <sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">
        <lookat origin="1, 1.5, 4.5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><rfilter type="box"/><string name="pixel_format" value="rgb"/></film></sensor>"""

# Most of the picture is seen through the ball, and little of it is noisy.
GLASS = """
    <emitter type="constant"><rgb name="radiance" value="0.5, 0.6, 0.7"/></emitter>
    <shape type="sphere"><bsdf type="dielectric"><float name="int_ior" value="{}"/><float name="ext_ior" value="1"/>
        </bsdf></shape>
    <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="4"/>
        <translate y="-1.2"/></transform><bsdf type="diffuse"><texture name="reflectance" type="checkerboard">
        <transform name="to_uv"><scale x="10" y="10"/></transform></texture></bsdf></shape>"""


@pytest.mark.parametrize("scene", ["diffuse", "materials", "thin-lens"])
def test_as_little_noise(stacks: Any, scene: str) -> None:
    """Lights are chosen no worse than by Mitsuba: the mean variance of a pixel, which 16 seeds give to some percent in
    scenes without fireflies, is at most a fifth above its.
    """
    ours, theirs = (images.var(axis=0).mean() for images in stacks(scene, spp=16))
    assert ours < 1.2 * theirs


def test_glass_and_glass_that_is_a_little_other(p_of: Any, tmp_path: Path) -> None:
    """The negative control is an index of refraction 2 % higher, at the same number of samples."""
    for name, index in (("right", 1.5), ("wrong", 1.02 * 1.5)):
        (tmp_path / f"{name}.xml").write_text(f"{HEAD}{GLASS.format(index)}</scene>")
    assert p_of(tmp_path / "right.xml") > FALSE_ALARMS
    assert p_of(tmp_path / "right.xml", tmp_path / "wrong.xml") < 1e-6


@pytest.mark.long
def test_glass_of_the_cornell_box_that_is_a_little_other(p_of: Any, tmp_path: Path) -> None:
    """The same control in the Cornell box, seen from nearer, whose noise takes more samples to look through."""
    from pmc_sampler import scenes

    text = scenes.path("cornell-box").read_text(encoding="utf-8")
    for old, new in (('"39.3077"', '"12"'), ('target="0, 1, 0"', 'target="0.4, 0.4, 0.4"')):
        assert text.count(old) == 1
        text = text.replace(old, new)
    (tmp_path / "right.xml").write_text(text)
    (tmp_path / "wrong.xml").write_text(text.replace('name="int_ior" value="1.5"', 'name="int_ior" value="1.53"'))
    assert p_of(tmp_path / "right.xml", spp=512) > FALSE_ALARMS
    assert p_of(tmp_path / "right.xml", tmp_path / "wrong.xml", spp=512) < FALSE_ALARMS


def test_hidden_emitters(p_of: Any, tmp_path: Path) -> None:
    """The camera looks through lamps, which light what is behind them."""
    hiding = HEAD.replace('value="8"/>', 'value="8"/><boolean name="hide_emitters" value="true"/>')
    # No ball behind the lamp: Mitsuba 3.9 puts what is seen through a lamp too near, which only balls mind.
    things = """<shape type="cube"><bsdf type="plastic"/></shape>
        <shape type="rectangle"><transform name="to_world"><scale value="0.7"/><rotate y="1" angle="150"/>
        <translate x="0.5" z="1.9"/></transform>
        <emitter type="area"><rgb name="radiance" value="4, 3, 2"/></emitter></shape>"""
    assert hiding != HEAD
    (tmp_path / "scene.xml").write_text(f"{hiding}{things}</scene>")
    assert p_of(tmp_path / "scene.xml") > FALSE_ALARMS


@pytest.mark.filterwarnings("ignore:Dr.Jit cannot record")  # the Mitsuba adapter, of nested BSDFs: what it costs
@pytest.mark.filterwarnings("ignore:Mitsuba.*exceed")  # of a lamp's texture, whose values are radiance
@pytest.mark.parametrize("name", PARTS)
def test_other_parts(p_of: Any, tmp_path: Path, name: str) -> None:
    import OpenImageIO

    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.linspace(0, 1, 32), np.linspace(0, 1, 16))
    sky = 0.2 + 3.0 * np.exp(-60 * ((x - 0.3) ** 2 + (y - 0.35) ** 2))[..., None] * [1.0, 0.8, 0.5] + 0.3 * y[..., None]
    slope = np.stack([0.5 + 0.2 * np.sin(9 * x), 0.5 + 0.15 * np.cos(7 * y + 2 * x), np.full_like(x, 0.95)], -1)
    images = {
        "sky": sky,
        "lamp": 12.0 * rng.random((4, 4, 3)) * [1.0, 0.9, 0.7],
        "tiles": 0.1 + 0.8 * rng.random((8, 8, 3)),
        "bumps": slope,
    }
    for file, pixels in images.items():
        buffer = OpenImageIO.ImageBuf(np.ascontiguousarray(pixels, np.float32))
        assert buffer.write(str(tmp_path / f"{file}.exr"), "float")
    (tmp_path / "scene.xml").write_text(f"{HEAD}{PARTS[name]}</scene>")
    assert p_of(tmp_path / "scene.xml") > FALSE_ALARMS
