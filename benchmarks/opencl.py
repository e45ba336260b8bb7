"""The OpenCL tracer's speed: against Mitsuba's, what leaving out saves, and where a render's time goes.

    python benchmarks/opencl.py [--scenes ...] [--size 320x240] [--spp 16] [--rounds 9] [--device NAME] [-o DIR]

Runs are interleaved, for the machine may be shared and its clock may drift: in each round every contender traces the
same number of paths, in an order that rotates, and a ratio is that of one round. The first, uncounted round compiles.
Mitsuba runs as `mi.render` with all samples at once, its fastest way, and as our adapter drives it.
"""

from __future__ import annotations

import argparse
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pmc_sampler.adapters.mitsuba import MitsubaRenderer
from pmc_sampler.adapters.opencl import OpenCLRenderer, program

from pmc_sampler import Budget, Config, Sampler, scenes
from pmc_sampler.cli.arguments import size

MESHES = {"mesh": 256, "mesh-million": 708}  # not built in: the side that mesh_scene takes
SCENES = ("cornell-box", "cornell-box-mirrors", "materials", "thin-lens", *MESHES)
TRACERS = ("OpenCL, Sobol", "OpenCL, independent", "Mitsuba by our adapter, Sobol", "mi.render, independent")
MATERIALS = ("DIFFUSE", "DIELECTRIC", "ROUGHDIELECTRIC", "CONDUCTOR", "ROUGHCONDUCTOR", "PLASTIC", "METALLIC_ROUGHNESS")
# What a kernel would hold if it were not made for its scene.
GENERAL = {
    "materials": {**{f"HAS_{name}": "1" for name in MATERIALS}, "HAS_DELTA": "1", "ONLY_KIND": None},
    "lights": {f"{name}_LIGHTS": "1" for name in ("TRIANGLE", "SPHERE", "POINT", "DIRECTIONAL")},
}
Contender = Callable[[], Any]


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    parts = [_head(options)]
    with tempfile.TemporaryDirectory() as folder:
        files = {name: mesh_scene(Path(folder), MESHES[name]) if name in MESHES else name for name in options.scenes}
        parts += [part(options, files) for part in (_against_mitsuba, _savings, _split)]
    text = "\n\n".join(parts) + "\n"
    print(text)
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "opencl.md").write_text(text, encoding="utf-8")
    return 0


def mesh_scene(folder: Path, side: int = 256) -> str:
    """The Cornell box with a bumpy ball of 2 side^2 triangles in place of the glass one; the path of its file."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, side + 1), np.linspace(0, np.pi, side + 1))
    r = 0.42 * (1.0 + 0.08 * np.sin(9 * u) * np.sin(11 * v) + 0.03 * np.sin(31 * u + 3) * np.sin(37 * v))
    points = np.stack([r * np.sin(v) * np.cos(u), r * np.cos(v) - 0.5, r * np.sin(v) * np.sin(u)], axis=-1)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    first = np.stack([corner, corner + 1, corner + side + 1], axis=1)
    second = np.stack([corner + 1, corner + side + 2, corner + side + 1], axis=1)
    faces = np.zeros(2 * len(corner), [("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, np.concatenate([first, second])
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {points.size // 3}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    (folder / f"ball-{side}.ply").write_bytes(
        header.encode() + points.reshape(-1, 3).astype("<f4").tobytes() + faces.tobytes()
    )
    text = scenes.path("cornell-box").read_text(encoding="utf-8")
    begin = text.index('<shape type="sphere"')
    end = text.index("</shape>", begin) + len("</shape>")
    ball = (
        '<shape type="ply"><string name="filename" value="ball-SIDE.ply"/><boolean name="face_normals" value="true"/>'
        '<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.6, 0.4"/></bsdf></shape>'
    )
    (folder / f"mesh-{side}.xml").write_text(
        text[:begin] + ball.replace("SIDE", str(side)) + text[end:], encoding="utf-8"
    )
    return str(folder / f"mesh-{side}.xml")


def drawn(width: int, height: int, spp: int) -> Any:
    """All samples of a uniform render, in the order in which the sampler draws them."""
    sampler = Sampler(width, height, Budget(spp=spp), Config.uniform(batch=width * height * spp), seed=1)
    return sampler.ask()


def seconds(contenders: dict[str, Contender], rounds: int) -> dict[str, Any]:
    """Of each contender in each round, (rounds,)."""
    taken: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(rounds + 1):
        names = list(contenders)
        for name in names[turn % len(names) :] + names[: turn % len(names)]:
            start = time.perf_counter()
            contenders[name]()
            if turn:
                taken[name].append(time.perf_counter() - start)
    return {name: np.array(values) for name, values in taken.items()}


def _against_mitsuba(options: argparse.Namespace, files: dict[str, str]) -> str:
    lines = [
        "## Against Mitsuba",
        "",
        "Paths in millions a second; ratios are ours, with Sobol points, over theirs: median (quartiles).",
        "",
        f"| scene | {' | '.join(TRACERS)} | over our adapter | over mi.render |",
        "|---|" + "---|" * (len(TRACERS) + 2),
    ]
    for name, file in files.items():
        taken = seconds(_tracers(options, file), options.rounds)
        paths = options.size[0] * options.size[1] * options.spp
        rates = [f"{paths / np.median(taken[tracer]) / 1e6:.2f}" for tracer in TRACERS]
        ratios = [_ratio(taken[other] / taken[TRACERS[0]]) for other in TRACERS[2:]]
        lines.append(f"| `{name}` | {' | '.join(rates + ratios)} |")
    return "\n".join(lines)


def _tracers(options: argparse.Namespace, file: str) -> dict[str, Contender]:
    batch = drawn(*options.size, options.spp)
    renderers = (
        OpenCLRenderer(file, "sobol", size=options.size, device=options.device),
        OpenCLRenderer(file, "independent", size=options.size, device=options.device),
        MitsubaRenderer(file, sampler="sobol", size=options.size),
    )
    scene = renderers[2].scene
    import mitsuba as mi

    def theirs() -> None:
        with mi.util.variant_context(renderers[2].variant):
            np.asarray(mi.render(scene, spp=options.spp, seed=1))

    made: dict[str, Contender] = {
        name: (lambda renderer=renderer: renderer(batch)) for name, renderer in zip(TRACERS[:3], renderers, strict=True)
    }
    return {**made, TRACERS[3]: theirs}


@contextmanager
def _changed(macros: dict[str, str | None]) -> Any:
    """Kernels are built with these macros in place of the scene's; None leaves one undefined."""
    build = program.build

    def general(context: Any, given: dict[str, str], *rest: Any) -> Any:
        merged = {**given, **{name: value for name, value in macros.items() if given.get(name, "0") == "0"}}
        return build(context, {name: value for name, value in merged.items() if value is not None}, *rest)

    program.build = general
    try:
        yield
    finally:
        program.build = build


def _savings(options: argparse.Namespace, files: dict[str, str]) -> str:
    lines = [
        "## What leaving out saves",
        "",
        "Time of a kernel that holds what its scene does not need, over that of the one that is used: every material,",
        "every kind of light, both; and the other way of the two to find what a ray hits. Median (quartiles).",
        "",
        "| scene | all materials | all lights | both | other way to trace |",
        "|---|---|---|---|---|",
    ]
    for name, file in files.items():
        batch = drawn(*options.size, options.spp)
        variants = {"used": {}, **GENERAL, "both": {**GENERAL["materials"], **GENERAL["lights"]}}
        contenders: dict[str, Contender] = {}
        for variant, macros in variants.items():
            with _changed(macros):
                renderer = OpenCLRenderer(file, size=options.size, device=options.device)
            contenders[variant] = partial(renderer, batch)
        through = len(renderer.scene.meshes) < 64 and sum(len(m.triangles) for m in renderer.scene.meshes) <= 64
        other = OpenCLRenderer(file, size=options.size, device=options.device, hierarchy=through)
        if through or options.all:
            contenders["other"] = partial(other, batch)
        taken = seconds(contenders, options.rounds)
        cells = [_ratio(taken[variant] / taken["used"]) for variant in ("materials", "lights", "both")]
        way = "hierarchy" if through else "one by one"
        cells.append(f"{way}: {_ratio(taken['other'] / taken['used'])}" if "other" in taken else f"{way}: not run")
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _split(options: argparse.Namespace, files: dict[str, str]) -> str:
    lines = [
        "## Where the time of a render goes",
        "",
        f"PMC at {options.spp} samples a pixel: shares of the sampler (ask and tell), of transfers to and from the",
        "device, of the kernel, and of the rest.",
        "",
        "| scene | seconds | sampler | transfers | kernel | rest |",
        "|---|---|---|---|---|---|",
    ]
    for name, file in files.items():
        renderer = OpenCLRenderer(file, size=options.size, device=options.device)
        runs = [_timed(renderer, options) for _ in range(options.rounds + 1)][1:]
        total, *shares = np.median(runs, axis=0)
        cells = [f"{share:.1%}" for share in (*shares, 1.0 - sum(shares))]
        lines.append(f"| `{name}` | {total:.2f} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _timed(renderer: OpenCLRenderer, options: argparse.Namespace) -> tuple[float, ...]:
    before = dict(renderer.seconds)
    sampler = Sampler(*options.size, Budget(spp=options.spp), Config(), seed=1)
    began = time.perf_counter()
    spent = 0.0
    while not sampler.done:
        start = time.perf_counter()
        batch = sampler.ask()
        spent += time.perf_counter() - start
        values = renderer(batch)
        start = time.perf_counter()
        sampler.tell(batch, values)
        spent += time.perf_counter() - start
    total = time.perf_counter() - began
    parts = [renderer.seconds[part] - before[part] for part in ("transfers", "kernel")]
    return (total, *(part / total for part in (spent, *parts)))


def _ratio(values: Any) -> str:
    low, middle, high = np.percentile(values, (25, 50, 75))
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def _head(options: argparse.Namespace) -> str:
    import mitsuba as mi

    device = OpenCLRenderer("diffuse", size=(16, 16), device=options.device).device
    command = "python " + " ".join(["benchmarks/opencl.py", *sys.argv[1:]])
    return (
        f"# Speed of the OpenCL tracer\n\n`{command}`\n\n{options.size[0]}x{options.size[1]} pixels, {options.spp} "
        f"samples a pixel, {options.rounds} rounds. Device: {device}; Mitsuba {mi.__version__}, LLVM on the same "
        f"processor; {platform.system()}, Python {platform.python_version()}."
    )


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES, metavar="NAME")
    parser.add_argument("--size", type=size, default=(320, 240), metavar="WxH")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--device", metavar="NAME", help="as pmc-sampler render has it")
    parser.add_argument("--all", action="store_true", help="also trace the mesh triangle by triangle, which takes long")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder of opencl.md")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    raise SystemExit(main())
