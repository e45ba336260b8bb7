"""The command line's grammar: what can be asked, and the sentence that what cannot gets."""

import argparse
import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from pmc_sampler import __version__, toml

NATIVE = "native"
METHODS = ("pmc", "pmc-paper", "pt", NATIVE)
DEFAULT_RENDERER = "opencl"
RENDERERS = {".pov": "povray", ".ini": "povray"}  # of files that one renderer alone reads
DEFAULT_SPP = 64
_SECTION = re.compile(r"(\.ini)\[([^\[\]]*)\]$", re.IGNORECASE)


class Parser(argparse.ArgumentParser):
    """A parser that answers bad input with one sentence instead of a page of usage."""

    def error(self, message: str) -> NoReturn:
        """Print the sentence to standard error and exit with status 2."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def parser() -> argparse.ArgumentParser:
    """The parser of ``pmc-sampler``; ``command`` of its result names what to do."""
    top = Parser(
        prog="pmc-sampler",
        description="Spends a renderer's samples where the eye sees noise, by Population Monte Carlo.",
        allow_abbrev=False,
    )
    top.add_argument("--version", action="version", version=f"pmc-sampler {__version__}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)
    _render(commands.add_parser("render", help="render a scene to an EXR and a PNG", allow_abbrev=False))
    _compare(commands.add_parser("compare", help="all metrics of one image against another", allow_abbrev=False))
    _bench(commands.add_parser("bench", help="run a suite of methods, scenes and budgets", allow_abbrev=False))
    _record(commands.add_parser("record", help="store a renderer's samples, to replay them", allow_abbrev=False))
    report = commands.add_parser("report", help="a folder of results as one HTML file", allow_abbrev=False)
    report.add_argument("results", type=Path, metavar="DIR", help="folder that bench wrote; report.html goes into it")
    for name, text in (
        ("scenes", "list the built-in scenes"),
        ("renderers", "list the renderers, and what a missing one needs"),
    ):
        command = commands.add_parser(name, help=text, allow_abbrev=False)
        command.add_argument("--json", action="store_true", help="print one JSON object")
    return top


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """What was asked for. Words after ``--`` are a renderer's own, such as POV-Ray's ``+K0.5``: ``own_options``."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    end = words.index("--") if "--" in words else len(words)
    top = parser()
    options = top.parse_args(words[:end])
    options.own_options = words[end + 1 :]
    if options.own_options and options.command != "render":
        top.error(f"{options.command} takes no options of a renderer: {words[end + 1]!r}")
    return options


def _render(p: argparse.ArgumentParser) -> None:
    p.usage = "%(prog)s SCENE [options] [-- RENDERER'S OWN OPTIONS]"
    _renderer(p)
    p.add_argument(
        "--method",
        choices=METHODS,
        default="pmc",
        help="pmc: the default sampler; pmc-paper: the paper's parameters; pt: uniform path tracing; native: the "
        "renderer's own anti-aliasing, for comparison (povray)",
    )
    p.add_argument(
        "--set",
        type=setting,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="settings",
        help="an option of the renderer or of its own anti-aliasing; VALUE as in TOML or a bare word; may be repeated",
    )
    p.add_argument(
        "--spp",
        type=positive,
        metavar="N",
        help=f"samples per pixel; default {DEFAULT_SPP} if no budget is given",
    )
    p.add_argument("--seconds", type=positive, metavar="S", help="stop after S seconds, set-up included")
    p.add_argument(
        "--visible-noise",
        type=share,
        metavar="F",
        help="stop when at most the share F of pixels shows noise, above 0 and below 1",
    )
    p.add_argument("--config", type=Path, metavar="FILE.toml", help="settings of the sampler that replace the method's")
    p.add_argument("-o", "--output", type=Path, metavar="OUT.exr", help="default: SCENE.exr in this folder")
    p.add_argument(
        "--checkpoint",
        type=Path,
        metavar="FILE",
        help="save the state to FILE, when interrupted, too, and resume from it if it exists; default: "
        "OUT.exr.checkpoint, once a render has taken longer than --checkpoint-every",
    )
    p.add_argument(
        "--checkpoint-every",
        type=positive,
        default=60.0,
        metavar="S",
        help="seconds from one checkpoint to the next; default: %(default)g",
    )
    p.add_argument(
        "--timeout",
        type=positive,
        metavar="S",
        help="give up where the renderer takes longer than S seconds for a batch, and write what there is",
    )
    p.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster that traces the batches, as tcp://HOST:8786"
    )
    p.add_argument("--json", action="store_true", help="print one JSON object")


def _renderer(p: argparse.ArgumentParser) -> None:
    """What is rendered, by whom and with which numbers."""
    p.add_argument("scene", type=scene, metavar="SCENE", help="a built-in scene's name or a scene file")
    p.add_argument(
        "--renderer",
        metavar="NAME",
        help=f"default: {DEFAULT_RENDERER}, and povray for .pov and .ini files",
    )
    p.add_argument(
        "--sampler",
        choices=("sobol", "independent"),
        default="sobol",
        help="the renderer's random numbers: Owen-scrambled Sobol points (default) or independent ones",
    )
    p.add_argument(
        "--device",
        metavar="NAME",
        help="OpenCL device: its number in `renderers`, cpu or gpu, or part of its name; default: $PMC_SAMPLER_DEVICE "
        "or the best",
    )
    p.add_argument("--size", type=size, metavar="WxH", help="image size in pixels; default: the scene's own")
    p.add_argument("--seed", type=seed, default=0, metavar="N", help="default: %(default)s")


def _record(p: argparse.ArgumentParser) -> None:
    _renderer(p)
    p.set_defaults(scheduler=None)
    p.add_argument(
        "--per-pixel", type=int, required=True, metavar="K", help="samples to store of each pixel, a power of two"
    )
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FILE.h5",
        help="where to; what is unfinished is in FILE.h5.part, from which the same command goes on",
    )


def _compare(p: argparse.ArgumentParser) -> None:
    p.add_argument("test", metavar="TEST", type=Path, help="an image file")
    p.add_argument("reference", metavar="REFERENCE", type=Path, help="the image file to measure it against")
    p.add_argument(
        "--white-luminance",
        type=positive,
        default=100.0,
        metavar="CD/M2",
        help="cd/m2 that a luminance of 1 stands for; default: %(default)s",
    )
    p.add_argument(
        "--exposure",
        type=positive,
        default=1.0,
        metavar="F",
        help="factor before display encoding; default: 1",
    )
    p.add_argument(
        "--pixels-per-degree",
        type=positive,
        metavar="N",
        help="pixels per degree of visual angle; default: FLIP's, 67.02",
    )
    p.add_argument("--maps", type=Path, metavar="FOLDER", help="write each metric's map there, as EXR and PNG")
    p.add_argument("--json", action="store_true", help="print one JSON object")


def _bench(p: argparse.ArgumentParser) -> None:
    p.add_argument(
        "suite",
        metavar="SUITE",
        nargs="?",
        default="quick",
        help="a suite that is shipped, or a .toml file; default: %(default)s",
    )
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder of the results; what is missing in it is run",
    )
    p.add_argument("--cache", type=Path, metavar="DIR", help="folder of the references; default: the user's cache")
    p.add_argument(
        "--timeout", type=positive, metavar="S", help="a run with a batch that takes longer than S seconds has failed"
    )
    p.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster that does the runs, as tcp://HOST:8786")


def renderer_for(scene: str) -> str:
    """The renderer that is meant where none is named."""
    return RENDERERS.get(scene_path(scene).suffix.lower(), DEFAULT_RENDERER)


def scene(text: str) -> str:
    """A scene's name or file; whether it exists is for the renderer to say."""
    if not scene_path(text).name:
        raise argparse.ArgumentTypeError(f"{text!r} is no scene; give a built-in scene's name or a scene file")
    return text


def scene_path(scene: str) -> Path:
    """The file of a scene that is one: without the section of an INI file, as in ``scene.ini[final]``."""
    return Path(_SECTION.sub(r"\1", scene))


def scene_section(scene: str) -> str:
    """The section of an INI file that a scene names; empty if it names none."""
    match = _SECTION.search(scene)
    return match[2] if match else ""


def size(text: str) -> tuple[int, int]:
    """``640x480`` as (width, height)."""
    match = re.fullmatch(r"(\d{1,6})x(\d{1,6})", text)
    if match is None or not (width := int(match[1])) or not (height := int(match[2])):
        raise argparse.ArgumentTypeError(f"{text!r} is no size; give width and height as in 640x480")
    return width, height


def positive(text: str) -> float:
    """A finite number above 0."""
    number = _number(text)
    if not (number > 0.0 and math.isfinite(number)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return number


def share(text: str) -> float:
    """A number between 0 and 1."""
    number = _number(text)
    if not 0.0 < number < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a share above 0 and below 1")
    return number


def setting(text: str) -> tuple[str, Any]:
    """``NAME=VALUE`` as a name and a value of TOML; what is none, such as a bare word, is a string."""
    name, equals, value = text.partition("=")
    if not equals or not name.isidentifier():
        raise argparse.ArgumentTypeError(f"{text!r} is no setting; give a name and a value as in timeout=60")
    try:
        return name, toml.value(value)
    except ImportError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def seed(text: str) -> int:
    """A whole number from 0 to 2^64 - 1."""
    if not re.fullmatch(r"\d{1,20}", text) or int(text) >= 2**64:
        raise argparse.ArgumentTypeError(f"{text!r} is no seed; give a whole number from 0 to 2^64 - 1")
    return int(text)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
