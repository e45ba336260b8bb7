"""``pmc-sampler bench``: runs a suite's missing runs into a folder of results."""

import argparse
import contextlib
import importlib
import signal
import sys
import time
from collections.abc import Iterator
from types import FrameType

from pmc_sampler.cluster import ClusterError

from .errors import CommandError
from .optional import load
from .progress import progress

INTERRUPTED = 130


def bench(options: argparse.Namespace) -> int:
    """Run what is missing, write the page of results and say what it took; returns the exit status."""
    suite_module = load("pmc_sampler.eval.suite", "benchmarks", "eval")
    benchmark = load("pmc_sampler.eval.benchmark", "benchmarks", "eval")
    results = load("pmc_sampler.eval.results", "benchmarks", "eval")
    markdown = load("pmc_sampler.eval.markdown", "benchmarks", "eval")
    executors = load("pmc_sampler.eval.executors", "benchmarks", "eval")
    images = load("pmc_sampler.eval.images", "benchmarks", "eval")
    for module in ("pyarrow", "tomli_w"):
        load(module, "benchmarks", "eval")
    if options.output.exists() and not options.output.is_dir():
        raise CommandError(f"the output {str(options.output)!r} is a file; name a folder.")
    address = options.scheduler
    executor = contextlib.nullcontext(executors.in_process) if address is None else executors.on_cluster(address)
    began = time.perf_counter()
    try:
        suite = suite_module.read(suite_module.find(options.suite))
        adapters = importlib.import_module("pmc_sampler.adapters")
        with (
            _terminated_as_interrupted(),
            executor as execute,
            progress(f"suite {suite.name}") as shown,
        ):
            benchmark.run(
                suite,
                results.Folder(options.output),
                benchmark.Renderers(adapters.load, adapters.version),
                cache=options.cache,
                execute=execute,
                timeout=options.timeout,
                log=_log,
                progress=shown,
            )
    except (suite_module.BadSuiteError, results.BadResultsError, ClusterError) as error:
        raise CommandError(str(error)) from error
    except (images.ImageError, OSError) as error:
        raise CommandError(f"results cannot be written: {str(error).rstrip('.')}.", status=1) from error
    except KeyboardInterrupt:
        raise CommandError(
            f"interrupted; {options.output} holds the runs until then, and the same command goes on from there.",
            INTERRUPTED,
        ) from None
    found = results.load(options.output)
    page = options.output / "results.md"
    results.write_text(page, markdown.page(found))
    print(f"{len(found.done)} runs are in {options.output}, {time.perf_counter() - began:.0f} s; {page} is written.")
    if found.failed:
        first = found.failed[0]
        raise CommandError(
            f"{len(found.failed)} runs failed, the first ({first['scene']}, {first['method']}): {first['error']}",
            status=1,
        )
    return 0


def _log(line: str) -> None:
    """A line for each run where no terminal shows progress."""
    if not sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)


@contextlib.contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """A termination signal, too, leaves a folder that can be resumed."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
