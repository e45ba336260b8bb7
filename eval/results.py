"""A benchmark's results folder: one Parquet file a run, the suite, and images.

``suite.toml`` is what was run, ``plan.json`` the ids of its runs, ``runs/ID.parquet`` one row each,
``images/SCENE/METHOD/BUDGET.exr`` the image of seed 1 and ``images/SCENE/reference.exr`` what it was measured
against. Files are written beside their place and renamed, so that a reader, or another process that writes, sees a
whole file or none.
"""

import contextlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import images, measures, statistics
from .references import Reference
from .suite import Scene, Suite, read, slug

Row = dict[str, Any]


class BadResultsError(ValueError):
    """A results folder that cannot be read or written; the message says which file and what to do."""


class Folder:
    """Where results are kept; made, with the folders above it, when something is first stored."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)

    def begin(self, suite: Suite, ids: Sequence[str]) -> None:
        """Note what is going to be run: the suite, and the ids of its runs in their order.

        Raises :class:`BadResultsError` where the folder has results of another suite, whose images would be mixed.
        """
        import tomli_w

        other = suite.name
        with contextlib.suppress(OSError, ValueError):  # none, or one that is damaged
            other = read(self.path / "suite.toml").name
        if other != suite.name:
            raise BadResultsError(
                f"{str(self.path)!r} holds results of the suite {other!r}: give {suite.name!r} another folder."
            )
        write_text(self.path / "suite.toml", tomli_w.dumps(suite.to_dict()))
        write_text(self.path / "plan.json", json.dumps({"ids": list(ids)}))

    def row(self, run_id: str) -> Row | None:
        """The row of a run, None where there is none. Raises :class:`BadResultsError` for a damaged file."""
        import pyarrow
        import pyarrow.parquet

        path = self._row_path(run_id)
        try:
            (row,) = pyarrow.parquet.read_table(path).to_pylist()
        except FileNotFoundError:
            return None
        except (OSError, ValueError, pyarrow.ArrowException) as error:
            raise BadResultsError(
                f"{str(path)!r} is damaged ({' '.join(str(error).split())}); delete it and the run is done again."
            ) from error
        return dict(row)

    def store(self, row: Row) -> None:
        """Keep a row, on disk before this returns."""
        import pyarrow
        import pyarrow.parquet

        schema = pyarrow.schema([(name, _type(name, value)) for name, value in row.items()])
        table = pyarrow.Table.from_pylist([row], schema=schema)
        write(self._row_path(row["id"]), lambda part: pyarrow.parquet.write_table(table, part))

    def store_image(
        self, path: Path, rgb: ArrayLike, layers: Mapping[str, ArrayLike], metadata: Mapping[str, Any]
    ) -> None:
        """Keep an image and its layers under ``path`` of the folder of images."""
        target = self.path / "images" / path
        target.parent.mkdir(parents=True, exist_ok=True)
        images.write_exr(target, rgb, layers, metadata)

    def image_id(self, path: Path) -> str:
        """The id of the run whose image lies under ``path``; empty where there is none, or none that can be read."""
        try:
            return str(images.read(self.path / "images" / path).metadata.get("pmc:id", ""))
        except images.ImageError:
            return ""

    def _row_path(self, run_id: str) -> Path:
        return self.path / "runs" / f"{run_id}.parquet"


@dataclass(frozen=True)
class Results:
    """What :func:`load` found: ``rows`` in the order of running, ``missing`` runs that have none yet."""

    path: Path
    suite: Suite
    rows: list[Row]
    missing: int

    @cached_property
    def done(self) -> list[Row]:
        """The rows of runs that did not fail."""
        return [row for row in self.rows if row["error"] is None]

    @property
    def failed(self) -> list[Row]:
        """The rows of runs that failed: `error` says why."""
        return [row for row in self.rows if row["error"] is not None]

    def select(self, scene: str, method: str, budget: str) -> list[Row]:
        """The rows of a scene, method and budget (as ``str`` of a suite's budget), by seed."""
        wanted = {"scene": scene, "method": method, "budget": budget}
        return sorted(
            (row for row in self.done if all(row[name] == value for name, value in wanted.items())),
            key=lambda row: int(row["seed"]),
        )

    def pairs(self, scene: str, budget: str, over: str, method: str, column: str) -> tuple[list[float], list[float]]:
        """An error of two methods, seed by seed, of the seeds that both have; 0 where it is not :func:`known`."""
        base = {row["seed"]: known(row, column) for row in self.select(scene, over, budget)}
        own = {row["seed"]: known(row, column) for row in self.select(scene, method, budget)}
        seeds = [seed for seed in own if seed in base]
        return [base[seed] for seed in seeds], [own[seed] for seed in seeds]

    def within(self, scene: str, method: str, limit: float, column: str, cost: str = "seconds.total") -> list[Row]:
        """The rows of a method on a scene, at that of its budgets with the least median error at no more cost.

        ``limit`` is compared with the budget's median of the column ``cost``; empty where every budget costs more.
        """
        (entry,) = (one for one in self.suite.scenes if one.name == scene)
        at_budgets = [self.select(scene, method, str(budget)) for budget in self.suite.budgets(entry)]

        def median(rows: list[Row], name: str) -> float:
            return statistics.median_interval([row[name] for row in rows]).median

        cheap = [rows for rows in at_budgets if rows and median(rows, cost) <= limit]
        return min(cheap, key=lambda rows: median(rows, column), default=[])

    def slope(self, scene: str, method: str, column: str) -> statistics.Interval | None:
        """Slope of log error against log samples, over the seeds that have every budget in samples.

        None where there are not two budgets, or no such seed, or an error is as small as the reference's noise.
        """
        (entry,) = (one for one in self.suite.scenes if one.name == scene)
        budgets = [budget for budget in entry.budgets if budget.kind == "spp"]
        values = [{row["seed"]: row[column] for row in self.select(scene, method, str(b))} for b in budgets]
        seeds = sorted(set.intersection(*(set(of_budget) for of_budget in values))) if values else []
        errors = np.array([[of_budget[seed] for of_budget in values] for seed in seeds])
        if len(budgets) < 2 or not seeds or not (errors > 0).all():
            return None
        return statistics.slope_interval([budget.value for budget in budgets], errors)

    def image_path(self, scene: str, method: str, budget: str) -> Path | None:
        """The EXR of seed 1; None where there is none yet."""
        path = self.path / "images" / image_name(scene, method, budget)
        return path if path.is_file() else None

    def reference_path(self, scene: str) -> Path | None:
        """The EXR of a scene's reference; None where there is none yet."""
        path = self.path / "images" / reference_name(scene)
        return path if path.is_file() else None

    def welch(self, scene: str, method: str, budget: str, alpha: float = 0.01) -> statistics.Welch | None:
        """The test of bias of a method's mean luminance in each tile of ``measures.TILE`` pixels, over seeds.

        None for fewer than two seeds, or without the reference's image.
        """
        rows, path = self.select(scene, method, budget), self.reference_path(scene)
        if len(rows) < 2 or path is None:
            return None
        reference = images.read(path)
        variance = reference.layers["luminance_variance"].astype(np.float64)
        return statistics.welch(
            np.array([row["tiles"] for row in rows]),
            measures.tiles(reference.rgb),
            # Pixels are independent of each other: a mean of n of them has an n-th of their mean variance.
            measures.tile_means(variance) / _tile_pixels(variance.shape),
            int(reference.metadata["pmc:replicates"]),
            alpha,
        )


def known(row: Row, column: str) -> float:
    """An error of a run; 0 where it is within three standard deviations of what the reference's noise leaves in it."""
    return float(row[column]) if row[column] > 3.0 * row.get(f"reference.{column}.deviation", 0.0) else 0.0


def noise_left(row: Row, number: Callable[[float], str] = "{:.2g}".format) -> str:
    """How far the subtraction of the reference's noise may be wrong, in words; empty for rows that do not say it."""
    parts = [
        f"{title} {number(row[column])}"
        for name, title in measures.ERRORS.items()
        if (column := f"reference.{name}.deviation") in row
    ]
    return f"; the standard deviation of what that leaves: {', '.join(parts)}" if parts else ""


def load(path: str | os.PathLike[str]) -> Results:
    """The results of a folder that ``pmc-sampler bench`` wrote, finished or not.

    Raises :class:`BadResultsError` for a folder that holds none and for a damaged file.
    """
    folder = Folder(path)
    try:
        ids = json.loads((folder.path / "plan.json").read_text(encoding="utf-8"))["ids"]
        if not isinstance(ids, list) or not all(isinstance(one, str) and one == os.path.basename(one) for one in ids):
            raise ValueError("its plan names other files than its own")
        suite = read(folder.path / "suite.toml")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        why = (error.strerror if isinstance(error, OSError) else None) or error
        raise BadResultsError(
            f"{str(path)!r} holds no results of a benchmark ({why}); `pmc-sampler bench -o {path}` makes them."
        ) from error
    rows = [row for row in (folder.row(run_id) for run_id in ids) if row is not None]
    return Results(folder.path, suite, rows, len(ids) - len(rows))


def image_name(scene: str, method: str, budget: str) -> Path:
    """Where the image of a run lies in the folder of images."""
    return Path(slug(scene), slug(method), f"{budget}.exr")


def reference_name(scene: str) -> Path:
    """Where a scene's reference lies in the folder of images."""
    return Path(slug(scene), "reference.exr")


def reference_image(reference: Reference, scene: Scene) -> tuple[ArrayLike, dict[str, ArrayLike], dict[str, Any]]:
    """A reference as the image, layers and metadata of its file."""
    layers: dict[str, ArrayLike] = {
        "variance": reference.variance,
        "luminance_variance": reference.luminance_variance,
    }
    names = ("spp", "replicates", "rejected", "seconds", "key")
    return (
        reference.mean,
        layers,
        {f"pmc:{name}": getattr(reference, name) for name in names} | {"pmc:scene": scene.name},
    )


def write(path: Path, save: Callable[[Path], Any]) -> None:
    """Have ``save`` write a file beside its place and rename it into it; makes the folder."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            save(partial)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise BadResultsError(f"{str(path)!r} cannot be written: {error.strerror or error}.") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file as :func:`write` does."""
    write(path, lambda part: part.write_text(text, encoding="utf-8"))


def _tile_pixels(shape: tuple[int, ...]) -> NDArray[np.float64]:
    rows, columns = (np.diff(np.append(np.arange(0, side, measures.TILE), side)) for side in shape)
    return np.outer(rows, columns).astype(np.float64)


def _type(name: str, value: Any) -> Any:
    """The Arrow type of a column, the same in every file; where nothing is known (None) it is a number."""
    import pyarrow

    if isinstance(value, str) or name == "error":
        return pyarrow.string()
    if isinstance(value, bool):
        return pyarrow.bool_()
    if isinstance(value, int):
        return pyarrow.int64()
    if isinstance(value, list):
        return pyarrow.list_(pyarrow.list_(pyarrow.float64()))
    return pyarrow.float64()
