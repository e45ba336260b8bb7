"""Renders the Cornell box by path tracing and by PMC at equal sample counts and shows what the difference is.

`make demo` runs it. Both get the same renderer with its best random numbers (Owen-scrambled Sobol points)
and the same number of samples; PMC only chooses where they go. Into the output folder go both images (EXR
with layers, PNG), the reference they are measured against, the crop of the caustic, the strategy image and
one picture with everything.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pmc_sampler.eval import images, metrics, references
from pmc_sampler.eval.display import display
from pmc_sampler.eval.metrics.encoded import SSIM_WINDOW

from pmc_sampler import Budget, Config, Result, adapters, render
from pmc_sampler.cli.arguments import Parser, seed, size
from pmc_sampler.cli.errors import CommandError
from pmc_sampler.cli.optional import load
from pmc_sampler.cli.progress import progress

SCENE = "cornell-box"
METHODS = {"pt": ("path tracing", Config.uniform()), "pmc": ("PMC", Config())}
# The caustic under the glass ball: left, top, right, bottom as shares of the image.
CAUSTIC = (0.46, 0.64, 0.80, 0.98)
ERRORS = (ValueError, TypeError, OSError, ImportError, RuntimeError, MemoryError)  # what renderers, too, may raise


def main(words: list[str] | None = None) -> int:
    options = arguments(words)
    width, height = options.size
    began = time.perf_counter()
    radiance = prepared(options)
    # The renderer compiles on first use; that is nobody's render time.
    render(radiance, width, height, Budget(spp=1), Config.uniform())

    results = {}
    for name, (title, config) in METHODS.items():
        say(f"rendering by {title}: {options.spp} samples per pixel at {width}x{height}")
        results[name] = render(radiance, width, height, Budget(spp=options.spp), config, seed=options.seed)
    say(f"rendering a reference of {options.reference_spp} samples per pixel")
    with progress("reference") as shown:
        reference = references.obtain(
            radiance,
            width,
            height,
            options.reference_spp,
            references.identify(SCENE, options.renderer, adapters.version(options.renderer)),
            cache=options.output / "reference",
            progress=lambda share: shown(share, ""),
        )
    write_images(options.output, results, reference)
    errors = {name: errors_of(result, reference) for name, result in results.items()}
    contact_sheet(options.output / "demo.png", results, reference, errors)
    print(table(results, reference, errors))
    print(f"\n{time.perf_counter() - began:.0f} s in all. Written to {options.output}/:")
    for file, text in files().items():
        print(f"  {file:34} {text}")
    return 0


def prepared(options: argparse.Namespace) -> Any:
    """The renderer, once all that can be refused was, and the output folder is there; raises CommandError."""
    try:
        check(options)
        say(f"loading {SCENE} for {options.renderer}")
        radiance = adapters.load(options.renderer, SCENE, size=options.size)
        make_folder(options.output)
    except ERRORS as error:
        raise CommandError(in_one_line(error)) from error
    return radiance


def check(options: argparse.Namespace) -> None:
    Budget(spp=options.spp)
    Config().resolved(*options.size)
    if min(options.size) < SSIM_WINDOW:
        shown = "x".join(map(str, options.size))
        raise ValueError(f"--size is {shown}: expected {SSIM_WINDOW}x{SSIM_WINDOW} at least, which SSIM needs")
    if options.reference_spp < 1 or options.reference_spp % references.REPLICATES:
        came, expected = options.reference_spp, references.REPLICATES
        raise ValueError(f"--reference-spp is {came}: expected a multiple of {expected}, and {expected} at least")
    if options.output.exists() and not options.output.is_dir():
        raise ValueError(f"the output {str(options.output)!r} is a file; name a folder")
    for module in ("OpenImageIO", "skimage", "matplotlib"):
        load(module, "the demo", "eval")


def make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"the folder {str(folder)!r} cannot be made: {error.strerror}") from error
    images.check_writable(folder / "pt.exr")


def arguments(words: list[str] | None) -> argparse.Namespace:
    parser = Parser(description=__doc__.splitlines()[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("demo"), metavar="DIR", help="made where it is missing"
    )
    parser.add_argument("--renderer", default="opencl", help="as `pmc-sampler renderers` lists them")
    parser.add_argument("--size", type=size, default=(320, 240), metavar="WxH", help="of the image, in pixels")
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel, for each method")
    parser.add_argument("--seed", type=seed, default=1, help="of both methods' random numbers")
    parser.add_argument(
        "--reference-spp", type=int, default=1024, help="a multiple of 16; kept in DIR for the next time"
    )
    return parser.parse_args(words)


def files() -> dict[str, str]:
    return {
        "demo.png": "everything in one picture",
        "pt.exr, pmc.exr": "images with layers: samples, standard error, strategy",
        "reference.exr": "the reference, with its variance; for `pmc-sampler compare`",
        "pt.png, pmc.png, reference.png": "the same, tone-mapped",
        "caustic-{pt,pmc,reference}.png": "the caustic, enlarged four times",
        "strategy.png": f"which radius proposed the samples ({radii()}), brighter where there are more",
        "reference/": "the reference as the next run of the demo reads it",
    }


def write_images(folder: Path, results: dict[str, Result], reference: references.Reference) -> None:
    """Write the EXR and PNG files."""
    for name, result in results.items():
        film = result.film
        layers = {"samples": film.samples, "error": film.standard_error, "strategy": film.strategy}
        images.write_exr(folder / f"{name}.exr", film.mean, layers, {"pmc:method": METHODS[name][0]})
    variance = {"variance": reference.variance, "luminance_variance": reference.luminance_variance}
    images.write_exr(folder / "reference.exr", reference.mean, variance, {"pmc:spp": reference.spp})
    for name, image in pictures(results, reference).items():
        images.write_png(folder / f"{name}.png", image)
        images.write_png(folder / f"caustic-{name}.png", enlarged(crop(image)))
    images.write_png_encoded(folder / "strategy.png", strategy_picture(results["pmc"]))


def pictures(results: dict[str, Result], reference: references.Reference) -> dict[str, NDArray[np.float32]]:
    return {**{name: result.film.mean for name, result in results.items()}, "reference": reference.mean}


def crop(image: NDArray[np.float32]) -> NDArray[np.float32]:
    height, width = image.shape[:2]
    left, top, right, bottom = CAUSTIC
    return image[round(top * height) : round(bottom * height), round(left * width) : round(right * width)]


def enlarged(image: NDArray[np.float32], factor: int = 4) -> NDArray[np.float32]:
    return image.repeat(factor, axis=0).repeat(factor, axis=1)


def strategy_picture(result: Result) -> NDArray[np.float32]:
    """The strategy image so that all of it can be seen: the densities span a thousandfold, so brightness is their
    logarithm, and most pixels have a few samples alone, so the colour is that of a neighbourhood.
    """
    from skimage.filters import gaussian

    strategy = result.film.strategy
    density = np.log(strategy.sum(axis=2, keepdims=True) + 1e-6)
    low, high = np.quantile(density, (0.01, 0.995))
    colour = gaussian(strategy, sigma=2, channel_axis=2)
    colour /= colour.max(axis=2, keepdims=True) + 1e-9
    return np.clip(colour * (density - low) / (high - low + 1e-6), 0.0, 1.0)


def radii() -> str:
    """The default kernel's radii with the colours of the strategy image."""
    colours = ("red", "green", "blue")
    sizes = Config().resolved(640, 480).radii or ()
    return ", ".join(f"{colour} {radius:g} px" for colour, radius in zip(colours, sizes, strict=True))


def errors_of(result: Result, reference: references.Reference) -> tuple[float, float]:
    """MSE and tvi error, the reference's own noise subtracted."""
    image = result.film.mean
    mse = metrics.mse(image, reference.mean, reference_variance=reference.variance)
    return mse, metrics.tvi_error(image, reference.mean, reference_variance=reference.luminance_variance)


def contact_sheet(
    path: Path, results: dict[str, Result], reference: references.Reference, errors: dict[str, tuple[float, float]]
) -> None:
    """One picture: images above, caustics below, strategy and sample counts beside them."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    titles = {"pt": "path tracing", "pmc": "PMC, same samples", "reference": f"path tracing, {reference.spp} spp"}
    figures = {
        name: f"MSE {mse:.2g}, tvi error {tvi:.2g}, {results[name].seconds['total']:.1f} s"
        for name, (mse, tvi) in errors.items()
    }
    figure, axes = pyplot.subplots(2, 4, figsize=(16, 6.6), layout="constrained")
    for column, (name, image) in enumerate(pictures(results, reference).items()):
        axes[0, column].imshow(display(image), interpolation="nearest")
        axes[0, column].set_title("\n".join((titles[name], figures.get(name, "the reference"))))
        axes[1, column].imshow(display(crop(image)), interpolation="nearest")
        axes[1, column].set_title(f"{titles[name]}: the caustic")
    axes[0, 3].imshow(strategy_picture(results["pmc"]), interpolation="nearest")
    axes[0, 3].set_title(f"radius of the kernel:\n{radii()}")
    counts = results["pmc"].film.samples
    density = axes[1, 3].imshow(counts, interpolation="nearest", norm="log", cmap="magma")
    axes[1, 3].set_title(f"samples per pixel: {counts.min()} to {counts.max()}")
    figure.colorbar(density, ax=axes[1, 3], orientation="horizontal", shrink=0.8, pad=0.02)
    for axis in axes.flat:
        axis.set_axis_off()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def table(results: dict[str, Result], reference: references.Reference, errors: dict[str, tuple[float, float]]) -> str:
    """Time split, errors and bias of both methods, the reference's own noise subtracted."""
    head = ("method", "spp", "seconds", "renderer", "sampler", "MSE", "tvi error", "SSIM", "bias")
    lines = ["".join(f"{name:>11}" for name in head)]
    for name, result in results.items():
        image, seconds = result.film.mean, result.seconds
        mse, tvi = errors[name]
        cells = (
            "PT" if name == "pt" else "PMC",
            f"{result.spp:g}",
            f"{seconds['total']:.2f}",
            f"{seconds['renderer'] / seconds['total']:.1%}",
            f"{seconds['sampler'] / seconds['total']:.1%}",
            f"{mse:.3g}",
            f"{tvi:.3g}",
            f"{metrics.ssim(image, reference.mean):.3f}",
            f"{metrics.bias(image, reference.mean):+.2%}",
        )
        lines.append("".join(f"{cell:>11}" for cell in cells))
    gains = [pt / pmc for pt, pmc in zip(errors["pt"], errors["pmc"], strict=True)]
    lines.append(
        f"\nAt equal samples PMC has {gains[0]:.1f} times less MSE and {gains[1]:.1f} times less tvi error "
        "than path tracing with the same Sobol points.\n"
        f"The reference has {reference.spp} samples per pixel; its own noise (MSE "
        f"{reference.variance.mean():.2g}) is subtracted; its mean luminance is known to "
        f"{reference.bias_error:.2%}."
    )
    return "\n".join(lines)


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def in_one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def command() -> int:
    """The demo; what it cannot do is one sentence, with exit status 2 for what was asked amiss, 1 for what failed."""
    try:
        return main()
    except CommandError as error:
        print(f"demo: {error}", file=sys.stderr)
        return error.status
    except ERRORS as error:
        print(f"demo failed: {in_one_line(error)}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(command())
