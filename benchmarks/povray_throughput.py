"""Positions per second through the POV-Ray adapter, and what it adds to the tracing.

    python benchmarks/povray_throughput.py [--positions 20000,80000,320000] [--processes 1,2,4,8] [--rounds 6]
    [-o DIR]

"trivial" is a ball on a plane under a point light. For each number of positions in a batch and of processes at once,
its rate end to end, batch after batch from the second on, as the median and the best of the rounds; and by processor
time the microseconds a position that go to POV-Ray (its start, reading the rays, tracing) and to our own process
(writing rays, reading images). The machine may be shared: processor time hardly depends on that, rates do.

"heavy" is the same ball under an area light, of as many lamps as make POV-Ray itself need about 40 microseconds a
position on this machine. There the
overhead is 1 - traced / ours, in processor seconds of a batch one after the other in each round: ours of all of our
processes; traced what POV-Ray spends tracing the same rays in the same order, by its own statistics. So what is added
is its start, the parsing of scene and rays, and the writing and reading by our own process. Beside it stands what
POV-Ray needs in all with the scene's own camera for an image of as many pixels, line by line: rays that come shuffled,
for independent noise, meet its caches less often.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from pmc_sampler.adapters.povray import PovRayRenderer, numbers, program
from pmc_sampler.adapters.povray.ray_mesh import mesh_camera

from pmc_sampler import Budget, Config, Sampler

TARGET = 40.0  # microseconds of a position of the heavy scene
WIDTH = 400  # pixels of the image; its height follows from the positions, one in each pixel
TRIVIAL = """#version 3.7;
global_settings { assumed_gamma 1 }
camera { location <0, 1, -5> direction z right x*4/3 up y }
light_source { <3, 4, -5> 1 }
sphere { <0, 1, 0>, 1 pigment { rgb <0.8, 0.5, 0.2> } }
plane { y, 0 pigment { checker rgb 0.9 rgb 0.1 } }
"""


def heavy_scene(lamps: int) -> str:
    """With an area light of so many lamps along each side."""
    return TRIVIAL.replace("-5> 1 }", f"-5> 1 area_light 4*x, 4*y, {lamps}, {lamps} }}")


def calibrated(size: tuple[int, int]) -> str:
    """The heavy scene whose positions take `TARGET`: its time grows with the number of lamps."""
    few, many = 10, 40
    low, high = (1e6 * native(heavy_scene(lamps), size) / (size[0] * size[1]) for lamps in (few, many))
    per_lamp = (high - low) / (many**2 - few**2)
    return heavy_scene(max(2, round(float(np.sqrt(few**2 + (TARGET - low) / per_lamp)))))


def ours(renderer: PovRayRenderer, batches: list[Any]) -> tuple[list[float], dict[str, float]]:
    """Seconds of each batch but the first, and of all those by what on, in processor time: "povray" and "python"."""
    renderer(batches[0])
    before, began, seconds = dict(renderer.seconds), time.process_time(), []
    for batch in batches[1:]:
        start = time.perf_counter()
        renderer(batch)
        seconds.append(time.perf_counter() - start)
    return seconds, {
        "povray": renderer.seconds["cpu"] - before["cpu"],
        "python": time.process_time() - began,
    }


def native(text: str, size: tuple[int, int]) -> float:
    """Processor seconds of POV-Ray with the scene's own camera, one position in each pixel."""
    with program.private_folder() as folder:
        switches = [f"+W{size[0]}", f"+H{size[1]}", "+FE", "+Oimage.exr", "-A", "-GD", "-GR", "-GS"]
        result = program.run(folder, text, switches)
        result.check("the scene")
        return float(result.cpu)


def traced(renderer: PovRayRenderer, text: str, batch: Any) -> float:
    """Processor seconds in which POV-Ray traces a batch's rays, in the order that the renderer gives them."""
    order = numbers.order(batch.scramble, batch.index, batch.number)
    rays = mesh_camera(renderer.camera, renderer.width, renderer.height, batch.positions[order].astype(np.float64))
    switches = [f"+W{len(order)}", "+H1", "+FE", "+Oimage.exr", "-A", "-GD", "-GR", "+BS1024"]
    with program.private_folder() as folder:
        result = program.run(folder, text + rays, switches)
        result.check("the scene")
    statistics = result.messages.partition("Trace Time:")[2]
    found = re.search(r"with ([\d.]+) CPU-seconds", statistics)
    assert found is not None, "POV-Ray writes its statistics"
    return float(found[1])


def drawn(size: tuple[int, int], count: int) -> list[Any]:
    """`count` batches of one uniform position in each pixel, as the sampler draws them."""
    sampler = Sampler(*size, Budget(spp=count), Config.uniform(batch=size[0] * size[1]), seed=1)
    batches = []
    while not sampler.done:
        batches.append(sampler.ask())
        sampler.tell(batches[-1], np.full((len(batches[-1]), 3), 0.5, np.float32))
    return batches


def trivial_rates(folder: Path, positions: int, processes: int, rounds: int) -> dict[str, float]:
    """The figures of one setting on the trivial scene."""
    size = (WIDTH, positions // WIDTH)
    (scene := folder / "trivial.pov").write_text(TRIVIAL)
    renderer = PovRayRenderer(scene, size=size, processes=processes, check=False)
    seconds, cpu = ours(renderer, drawn(size, rounds + 1))
    renderer.close()
    count = size[0] * size[1]
    return {
        "positions": count,
        "processes": processes,
        "rate_median": count / float(np.median(seconds)),
        "rate_best": count / min(seconds),
        "povray_microseconds": 1e6 * cpu["povray"] / (rounds * count),
        "python_microseconds": 1e6 * cpu["python"] / (rounds * count),
    }


def overhead(folder: Path, positions: int, processes: int, rounds: int) -> dict[str, Any]:
    """On the heavy scene: processor microseconds a position of both, and the overhead in each round."""
    size = (WIDTH, positions // WIDTH)
    text = calibrated(size)
    (scene := folder / "heavy.pov").write_text(text)
    renderer = PovRayRenderer(scene, size=size, processes=processes, check=False)
    batches, count = drawn(size, rounds + 1), size[0] * size[1]
    renderer(batches[0])
    rows = []
    for batch in batches[1:]:
        # The same processes wait before and after: what one batch spends on starting the next one's is as in any other.
        before, began = renderer.seconds["cpu"], time.process_time()
        renderer(batch)
        both = renderer.seconds["cpu"] - before + time.process_time() - began
        rows.append((native(text, size), traced(renderer, text, batch), both))
    renderer.close()
    table = np.array(rows) / count * 1e6
    shares = 1 - table[:, 1] / table[:, 2]
    return {
        "positions": count,
        "processes": processes,
        "native_microseconds": float(np.median(table[:, 0])),
        "traced_microseconds": float(np.median(table[:, 1])),
        "our_microseconds": float(np.median(table[:, 2])),
        "overhead_median": float(np.median(shares)),
        "overhead_by_round": [float(value) for value in shares],
    }


def table(figures: dict[str, Any]) -> str:
    """The figures as Markdown."""
    lines = [
        "# Throughput of the POV-Ray adapter\n",
        f"`{figures['command']}` on {figures['processors']} processors, with {figures['version']}. What is measured is "
        "in the head of `benchmarks/povray_throughput.py`.\n",
        "A trivial scene; microseconds are of processor time, for each position:\n",
        "| positions in a batch | processes | positions/s, median | best | POV-Ray, us | our process, us |",
        "|---:|---:|---:|---:|---:|---:|",
    ]
    for row in figures["trivial"]:
        lines.append(
            f"| {row['positions']} | {row['processes']} | {row['rate_median']:.0f} | {row['rate_best']:.0f} | "
            f"{row['povray_microseconds']:.2f} | {row['python_microseconds']:.2f} |"
        )
    lines += [f"\n{_sentence(heavy)}" for heavy in figures["heavy"]]
    return "\n".join(lines) + "\n"


def _sentence(heavy: dict[str, Any]) -> str:
    rounds = heavy["overhead_by_round"]
    return (
        f"Rays that POV-Ray traces in {heavy['traced_microseconds']:.1f} us each take "
        f"{heavy['our_microseconds']:.1f} us in all by batches of {heavy['positions']} in {heavy['processes']} "
        f"processes, in processor time: an overhead of {heavy['overhead_median']:.1%} "
        f"(rounds from {min(rounds):.1%} to {max(rounds):.1%}). With the scene's own camera, line by line, "
        f"POV-Ray takes {heavy['native_microseconds']:.1f} us a pixel in all."
    )


def main(arguments: list[str] | None = None) -> int:
    """Measures, prints the table and writes the figures where asked."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--positions", default="20000,80000,320000", help="in a batch")
    parser.add_argument("--processes", default="1,2,4,8", help="at once")
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="folder of povray_throughput.md and .json")
    options = parser.parse_args(arguments)
    figures: dict[str, Any] = {
        "command": "python " + " ".join(sys.argv),
        "version": PovRayRenderer.version(),
        "processors": len(os.sched_getaffinity(0)),
        "trivial": [],
    }
    with tempfile.TemporaryDirectory() as name:
        for positions in (int(count) for count in options.positions.split(",")):
            for processes in (int(count) for count in options.processes.split(",")):
                figures["trivial"].append(trivial_rates(Path(name), positions, processes, options.rounds))
                print(figures["trivial"][-1], file=sys.stderr)
        each = len(os.sched_getaffinity(0))
        figures["heavy"] = [overhead(Path(name), 80_000, count, options.rounds) for count in (each, 2 * each)]
    print(table(figures))
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "povray_throughput.md").write_text(table(figures), encoding="utf-8")
        (options.output / "povray_throughput.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
