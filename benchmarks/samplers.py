"""Measures the samplers against each other on the built-in scenes; `make bench` runs it.

Writes ``samplers.jsonl`` (one row a run, resumed when interrupted) and ``results.md`` into the output folder.
References are rendered once and kept in the user's cache folder.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pmc_sampler.eval import benchmark, references, results

from pmc_sampler import __version__, adapters, scenes
from pmc_sampler.cli.arguments import size

SCENES = ("cornell-box", "cornell-box-mirrors", "thin-lens", "diffuse")


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    plan = benchmark.Plan(
        scenes=tuple(options.scenes),
        width=options.size[0],
        height=options.size[1],
        spp=options.spp,
        seeds=options.seeds,
        reference_spp=options.reference_spp,
        identities={
            name: references.identify(name, options.renderer, adapters.version(options.renderer))
            for name in options.scenes
        },
        code=benchmark.fingerprint(_adapter_files(options.renderer)),
    )
    options.output.mkdir(parents=True, exist_ok=True)
    rows = benchmark.run(
        plan,
        _loader(options.renderer, *options.size),
        benchmark.Rows(options.output / "samplers.jsonl"),
        cache=options.cache,
        log=lambda line: print(line, file=sys.stderr, flush=True),
    )
    text = results.page(
        rows,
        [method.name for method in plan.methods],
        benchmark.BASELINE.name,
        benchmark.STRATIFIED.name,
        command=_command(options),
        versions=_versions(options.renderer),
    )
    results.write(options.output / "results.md", text)
    print(f"{options.output / 'results.md'} is written.")
    return 0


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder of the results")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="folder of the references; default: the user's cache")
    parser.add_argument("--renderer", default="mitsuba", choices=adapters.names())
    parser.add_argument("--scenes", nargs="+", default=SCENES, choices=scenes.names(), metavar="NAME")
    parser.add_argument("--size", type=size, default=(320, 240), metavar="WxH")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--reference-spp", type=int, default=4096)
    return parser.parse_args(arguments)


def _loader(renderer: str, width: int, height: int) -> Callable[[str, str], Any]:
    return lambda scene, sampler: adapters.load(renderer, scene, size=(width, height), sampler=sampler)


def _adapter_files(renderer: str) -> list[Path]:
    folder = Path(adapters.__file__).parent / renderer
    return sorted(file for file in folder.rglob("*") if file.suffix in (".py", ".cl", ".hpp"))


def _versions(renderer: str) -> dict[str, str]:
    return {"pmc-sampler": __version__, renderer: adapters.version(renderer)}


def _command(options: argparse.Namespace) -> str:
    words = ["python benchmarks/samplers.py -o benchmarks/"]
    defaults = _options(["-o", "."])
    if tuple(options.scenes) != tuple(defaults.scenes):
        words.append("--scenes " + " ".join(options.scenes))
    if options.size != defaults.size:
        words.append(f"--size {options.size[0]}x{options.size[1]}")
    for name in ("renderer", "spp", "seeds", "reference_spp"):
        if getattr(options, name) != getattr(defaults, name):
            words.append(f"--{name.replace('_', '-')} {getattr(options, name)}")
    return " ".join(words)


if __name__ == "__main__":
    sys.exit(main())
