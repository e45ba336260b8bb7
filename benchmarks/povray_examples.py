"""Whether the scenes of Debian's povray-examples can be driven, one by one; writes povray_examples.md.

    python benchmarks/povray_examples.py -o benchmarks/ [--folder /usr/share/doc/povray/examples] [--jobs 2]

Each scene that has a camera is loaded as any user's would be: its camera is found, and its image of 64 pixels width
through that camera is compared with POV-Ray's own. It "agrees" if 97 % of the pixels are the same within 1 %; "differs
by its noise" if the two images are at most three times as far apart as two of ours with other random numbers are; else
it "fails", with the sentence that a user gets. Of an animation, which has an INI file of its name, it is the first
frame. Rows are kept in povray_examples.jsonl: an interrupted run goes on.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from pmc_sampler.adapters.povray import PovRayRenderer, program

EXAMPLES = Path("/usr/share/doc/povray/examples")
SIZE = (64, 48)
AGREES, NOISE, FAILS = "agrees", "differs by its noise", "fails"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--folder", type=Path, default=EXAMPLES, metavar="DIR", help="default: %(default)s")
    parser.add_argument("--jobs", type=int, default=2, help="scenes at once; default: %(default)s")
    parser.add_argument("--timeout", type=float, default=300.0, help="seconds a run of POV-Ray; default: %(default)g")
    options = parser.parse_args(arguments)
    scenes = sorted(options.folder.rglob("*.pov"))
    if not scenes:
        parser.error(f"there are no scenes in {options.folder}: apt install povray-examples")
    options.output.mkdir(parents=True, exist_ok=True)
    rows = examine_all(scenes, options)
    (options.output / "povray_examples.md").write_text(page(rows), encoding="utf-8")
    print(summary(rows))
    return 0


def examine_all(scenes: Sequence[Path], options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each scene, in their order; those that there are already are not made again."""
    kept = options.output / "povray_examples.jsonl"
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.is_file() else []
    done = {row["scene"]: row for row in map(json.loads, lines)}
    todo = [scene for scene in scenes if str(scene.relative_to(options.folder)) not in done]
    with kept.open("a", encoding="utf-8") as file, ThreadPoolExecutor(options.jobs) as pool:
        for row in pool.map(lambda scene: examine(scene, options.folder, options.timeout), todo):
            file.write(json.dumps(row) + "\n")
            file.flush()
            done[row["scene"]] = row
            print(f"{len(done)}/{len(scenes)} {row['scene']}: {row['outcome']}", file=sys.stderr)
    return [done[str(scene.relative_to(options.folder))] for scene in scenes]


def examine(scene: Path, folder: Path, timeout: float) -> dict[str, Any]:
    """What becomes of a scene."""
    began = time.perf_counter()
    row: dict[str, Any] = {"scene": str(scene.relative_to(folder))}
    try:
        renderer = PovRayRenderer(scene, size=SIZE, timeout=timeout, options=frame(scene))
    except (ValueError, OSError, RuntimeError) as error:
        row |= {"outcome": FAILS, "camera": None, "sentence": " ".join(str(error).split()).replace(str(folder), "")}
    else:
        agreement = renderer.agreement
        assert agreement is not None
        row |= {
            "outcome": AGREES if agreement.noise is None else NOISE,
            "camera": renderer.camera.kind,
            "same": round(agreement.same, 4),
            "apart": round(agreement.apart, 4),
            "noise": None if agreement.noise is None else round(agreement.noise, 4),
        }
        renderer.close()
    return row | {"seconds": round(time.perf_counter() - began, 1)}


def frame(scene: Path) -> list[str]:
    """The options for the first frame, where the scene is an animation."""
    ini = scene.with_suffix(".ini")
    text = ini.read_text(encoding="utf-8", errors="replace") if ini.is_file() else ""
    if not re.search(r"^\s*(Final_Frame|[+-]KFF)", text, re.IGNORECASE | re.MULTILINE):
        return []
    first = re.search(r"^\s*Initial_Frame\s*=\s*(\d+)", text, re.IGNORECASE | re.MULTILINE)
    return [str(ini), f"+SF{first[1] if first else 1}"]


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """The counts in words."""
    counts = Counter(row["outcome"] for row in rows)
    kinds = Counter(row["camera"] for row in rows if row["camera"])
    return (
        f"Of {len(rows)} scenes {counts[AGREES]} agree, {counts[NOISE]} differ by their noise and {counts[FAILS]} "
        f"fail. Cameras: {', '.join(f'{count} {kind}' for kind, count in kinds.most_common())}."
    )


def page(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = [
        "# POV-Ray's examples through the sampler's camera\n",
        f"`python benchmarks/povray_examples.py -o benchmarks/`, POV-Ray {program.version()}. What the words mean "
        "is in the head of `benchmarks/povray_examples.py`.\n",
        summary(rows) + "\n",
        "| scene | camera | outcome | same pixels | apart | noise |",
        "|---|---|---|---:|---:|---:|",
    ]
    for row in rows:
        if row["outcome"] == FAILS:
            lines.append(f"| {row['scene']} | | {FAILS}: {row['sentence'].replace('|', '/')} | | | |")
            continue
        noise = "" if row["noise"] is None else f"{row['noise']:.1%}"
        shares = f"{row['same']:.1%} | {row['apart']:.1%} | {noise}"
        lines.append(f"| {row['scene']} | {row['camera']} | {row['outcome']} | {shares} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
