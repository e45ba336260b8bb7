"""What the sampler's tests share, each as a fixture: a NumPy twin of the Sobol points, renderers that cost nothing and
are functions of the batch alone, an oracle that recomputes the film in float64, and ways of driving a sampler.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Batch, Budget, Config, Film, Sampler

Radiance = Callable[[Batch], np.ndarray]
Words = Any  # whatever broadcasts to an array of uint32


# --- Sobol points by hash: doi Burley 2020 (JCGT 9(4)), with lowbias32 for keys --------------------------------------
def hash32(x: Words) -> np.ndarray:
    x = np.asarray(x, np.uint32)
    with warnings.catch_warnings():  # scalars warn where arrays wrap in silence
        warnings.simplefilter("ignore", RuntimeWarning)
        x = (x ^ (x >> np.uint32(16))) * np.uint32(0x7FEB352D)
        x = (x ^ (x >> np.uint32(15))) * np.uint32(0x846CA68B)
    return x ^ (x >> np.uint32(16))


def mix(a: Words, b: Words) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return hash32(np.asarray(a, np.uint32) ^ hash32(np.asarray(b, np.uint32) + np.uint32(0x9E3779B9)))


def reverse_bits(x: Words) -> np.ndarray:
    """By way of text: slow, and unlike the core's."""
    x = np.atleast_1d(np.asarray(x, np.uint32))
    bits = np.unpackbits(x.astype(">u4").view(np.uint8).reshape(-1, 4), axis=1)
    return np.packbits(bits[:, ::-1], axis=1).view(">u4").astype(np.uint32).reshape(x.shape)


def owen_reversed(x: Words, key: Words) -> np.ndarray:
    x, key = np.asarray(x, np.uint32), np.asarray(key, np.uint32)
    x = x ^ x * np.uint32(0x3D20ADEA)
    x = (x + key) * ((key >> np.uint32(16)) | np.uint32(1))
    x = x ^ x * np.uint32(0x05526C56)
    return x ^ x * np.uint32(0x53A22864)


def second_sobol_matrix() -> np.ndarray:
    """Generator columns of the second Sobol dimension (primitive polynomial x + 1): v_k = v_{k-1} xor v_{k-1} / 2."""
    columns = [1 << 31]
    for _ in range(31):
        columns.append(columns[-1] ^ (columns[-1] >> 1))
    return np.array(columns, np.uint64).astype(np.uint32)


def sobol_pair(scramble: Words, index: Words, pair: Words) -> np.ndarray:
    """Points (n, 2) float32, through the generator matrix where the core uses a closed form."""
    scramble, index = np.atleast_1d(np.asarray(scramble, np.uint32)), np.atleast_1d(np.asarray(index, np.uint32))
    key = np.broadcast_to(mix(scramble, pair), index.shape)
    shuffled = reverse_bits(owen_reversed(reverse_bits(index), key))
    second = np.zeros_like(shuffled)
    for bit, column in enumerate(second_sobol_matrix()):
        second ^= np.where((shuffled >> np.uint32(bit)) & np.uint32(1), column, np.uint32(0))
    x = reverse_bits(owen_reversed(shuffled, hash32(key ^ np.uint32(0x68BC21EB))))
    y = reverse_bits(owen_reversed(reverse_bits(second), hash32(key ^ np.uint32(0x02E5BE93))))
    return (np.stack([x, y], axis=1) >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-24)


# --- Renderers -------------------------------------------------------------------------------------------------------
def noise(batch: Batch, salt: int = 0) -> np.ndarray:
    """Independent uniform numbers in [0, 1), a function of (scramble, index, salt)."""
    return hash32(mix(batch.scramble, salt) ^ hash32(batch.index)) / 2.0**32


def rgb(grey: np.ndarray) -> np.ndarray:
    """Three unequal channels in proportion to `grey`."""
    return (grey[:, None] * np.array([1.0, 0.5, 2.0])).astype(np.float32)


def constant(batch: Batch) -> np.ndarray:
    return np.tile(np.array([0.7, 0.3, 0.1], np.float32), (len(batch), 1))


def black(batch: Batch) -> np.ndarray:
    return np.zeros((len(batch), 3), np.float32)


def textured(batch: Batch) -> np.ndarray:
    """Mean and noise differ from pixel to pixel, channels from one another."""
    strength = (hash32(batch.pixel) / 2.0**32)[:, None] * np.array([1.0, 0.3, 2.0])
    return (0.1 + strength * np.stack([noise(batch, c) for c in range(3)], axis=1) ** 3).astype(np.float32)


def spikes(batch: Batch) -> np.ndarray:
    """One sample in 64 is 64 times brighter; the mean is 1 everywhere."""
    return rgb(np.where(noise(batch) < 1 / 64, 32.0, 32 / 63))


def right_half(width: int, image: Radiance = textured) -> Radiance:
    """Black left of the middle."""

    def render(batch: Batch) -> np.ndarray:
        return image(batch) * (batch.pixel % width >= width // 2)[:, None]

    return render


# --- The oracle ------------------------------------------------------------------------------------------------------
def smoother(size: int, sigma: float) -> np.ndarray:
    """One axis of the energy correction's smoother as a symmetric matrix (size, size): splat to cells, blur, gather."""
    cell = max(1, int(sigma / 3))
    cells = -(-size // cell)
    at = (np.arange(size) + 0.5) / cell - 0.5
    low, t = np.floor(at).astype(int), at - np.floor(at)
    gather = np.zeros((size, cells))
    for i, part in ((low, 1 - t), (low + 1, t)):
        np.add.at(gather, (np.arange(size), np.clip(i, 0, cells - 1)), part)
    s = np.sqrt(max(sigma**2 - cell**2 / 3, 0.01)) / cell
    reach = int(np.ceil(3.5 * s))
    steps = np.arange(-reach, reach + 1)
    kernel = np.exp(-0.5 * (steps / s) ** 2)
    blur = np.zeros((cells, cells))
    for step, k in zip(steps, kernel / kernel.sum(), strict=True):
        folded = (np.arange(cells) + step) % (2 * cells)
        np.add.at(blur, (np.arange(cells), np.minimum(folded, 2 * cells - 1 - folded)), k)
    result: np.ndarray = gather @ blur @ gather.T / cell
    return result


def peak(size: int, sigma: float) -> np.ndarray:
    """What share of itself a pixel keeps, along one axis."""
    i = np.arange(size)
    distances = np.stack([np.zeros(size), 2.0 * i + 1, 2.0 * (size - i) - 1])
    gaussian = np.exp(-0.5 * (distances / sigma) ** 2).sum(axis=0) / (np.sqrt(2 * np.pi) * sigma)
    return np.clip(gaussian, 1 / size, 1.0)


def corrected(
    plain: np.ndarray, pool: np.ndarray, pool_samples: np.ndarray, size: np.ndarray, config: Config, signed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """`Film.mean` of (height, width, 3) means, and the size of the terms that it is summed from; `size` is that of the
    terms of both means of a pixel.
    """
    if config.correction == 0.0 or config.pool_share == 1.0 or config.estimator == "unbiased":
        return plain, size
    height, width = pool_samples.shape
    sigma, knee = config.correction_sigma, config.correction_knee
    columns, rows = smoother(width, sigma), smoother(height, sigma)
    image, size = plain.copy(), size.copy()
    for c in range(3):
        P, U = plain[..., c], pool[..., c]
        blurred = [rows @ a @ columns.T for a in (np.ones_like(P), np.maximum(P, 0))]
        local = blurred[1] / blurred[0]
        with np.errstate(all="ignore"):
            w = np.where(P > 0, P / (P + knee * local), 0.0)
            spread = rows @ w @ columns.T
            lacking = np.where(pool_samples > 0, U - P, 0.0)
            most = np.where(lacking > 0, 2.0, 0.5)
            own = peak(height, sigma)[:, None] * peak(width, sigma)
            alike = np.minimum(1.0, knee / np.maximum(1 - spread, knee))
            brightness = np.where(lacking > 0, np.maximum(knee, spread), alike)
            change = own * np.abs(lacking) / (spread * local * brightness)
            share = np.where(change <= most, 1.0, (most / change) ** 4)
            share[lacking == 0] = 1.0
            moved, terms = (np.where(spread > 0, share * a / spread, 0.0) for a in (lacking, size[..., c]))
        image[..., c] += config.correction * (w * (rows @ moved @ columns.T) + (1 - share) * lacking)
        size[..., c] += w * (rows @ terms @ columns.T)
    return np.clip(image, -np.inf if signed else 0.0, np.finfo(np.float32).max), size


class Oracle:
    """Every picture of the film that follows from all batches told, in float64. Batches count in the order of their
    numbers, up to the first that is neither told nor dropped.
    """

    def __init__(self, sampler: Sampler) -> None:
        self.sampler = sampler
        self.batches: dict[int, tuple[Batch, np.ndarray]] = {}
        self.dropped: set[int] = set()

    def watch(self, radiance: Radiance) -> Radiance:
        """A renderer that gives the same and is remembered; for one that is told all that it renders."""

        def render(batch: Batch) -> np.ndarray:
            values = radiance(batch)
            self.add(batch, values)
            return values

        return render

    def add(self, batch: Batch, radiance: np.ndarray) -> None:
        self.batches[batch.number] = (batch, np.array(radiance))

    def drop(self, batch: Batch) -> None:
        self.dropped.add(batch.number)

    def joined(self) -> SimpleNamespace:
        """The samples of all batches that count."""
        told = []
        for number in itertools.count():
            if number in self.batches:
                told.append(self.batches[number])
            elif number not in self.dropped:
                break
        types = {"positions": np.float32, "pixel": np.uint32, "index": np.uint32, "scramble": np.uint32}
        shapes = {"positions": (0, 2)}
        arrays = {
            name: np.concatenate([np.zeros(shapes.get(name, 0), kind), *(getattr(batch, name) for batch, _ in told)])
            for name, kind in types.items()
        }
        values = [np.zeros((0, 3 + self.sampler.aovs)), *(values for _, values in told)]
        return SimpleNamespace(radiance=np.concatenate(values).astype(np.float64), **arrays)

    def pictures(self) -> dict[str, np.ndarray]:
        return {name: picture for name, (picture, _) in self._pictures().items()}

    def _pictures(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Each with the mean size of what its pixels are summed from."""
        s = self.sampler
        pixels, shape = s.width * s.height, (s.height, s.width)
        all_ = self.joined()
        rgb_, finite = all_.radiance[:, :3], np.isfinite(all_.radiance).all(axis=1)
        valid = finite & (s.signed | (rgb_ >= 0).all(axis=1))
        order = np.flatnonzero(valid)[np.argsort(all_.pixel[valid], kind="stable")]
        pixel, values = all_.pixel[order], all_.radiance[order]
        pool = from_pool(s, all_)[order]

        def count(mask: np.ndarray) -> np.ndarray:
            return np.bincount(pixel[mask], minlength=pixels)

        def mean(mask: np.ndarray, array: np.ndarray) -> np.ndarray:
            sums = [np.bincount(pixel[mask], array[mask, c], pixels) for c in range(array.shape[1])]
            result = np.stack(sums, axis=1) / np.maximum(count(mask), 1)[:, None] if sums else np.zeros((pixels, 0))
            return result.reshape(*shape, -1)

        every = np.ones(len(pixel), bool)
        samples = count(every)
        rank = np.arange(len(pixel)) - (np.cumsum(samples) - samples)[pixel]
        average, size = mean(every, values), mean(every, np.abs(values))
        squares = mean(every, (values - average.reshape(pixels, -1)[pixel])[:, :3] ** 2)
        n = samples.reshape(*shape, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.where(n > 1, np.sqrt(squares / (n - 1.0)), np.inf)
        counts = {
            "samples": n[..., 0],
            "pool_samples": count(pool).reshape(shape),
            "rejected": np.array((~valid).sum()),
        }
        pool_mean, pool_size = mean(pool, values[:, :3]), mean(pool, np.abs(values[:, :3]))
        sizes = size[..., :3] + pool_size
        half = [mean(rank % 2 == i, values[:, :3]) for i in (0, 1)]
        # All samples of a pixel are in what the second half is computed from.
        return {
            **{name: (picture, np.zeros(())) for name, picture in counts.items()},
            "plain_mean": (average[..., :3], size[..., :3]),
            "aovs": (average[..., 3:], size[..., 3:]),
            "standard_error": (error, size[..., :3]),
            "pool_mean": (pool_mean, pool_size),
            "first_half": (half[0], mean(rank % 2 == 0, np.abs(values[:, :3]))),
            "second_half": (half[1], 2 * size[..., :3]),
            "mean": corrected(average[..., :3], pool_mean, counts["pool_samples"], sizes, s.config, s.signed),
        }

    def check(self, film: Film) -> None:
        """Raises AssertionError, with the picture's name, where the film is another: counts exactly, the others within
        a part of what their pixels are summed from. Halves are kept as floats, and what the correction spreads is.
        """
        expected = self._pictures()
        first, second = film.halves
        assert np.array_equal(film.samples, expected["samples"][0]), "samples"
        assert self.sampler.rejected == expected["rejected"][0], "rejected"
        assert self.sampler.samples == expected["samples"][0].sum(), "total"
        tolerances = {"first_half": 1e-5, "second_half": 1e-5, "mean": 2e-6}
        actual = {"first_half": first, "second_half": second}
        for name in ("plain_mean", "aovs", "standard_error", "pool_mean", "first_half", "second_half", "mean"):
            picture, size = expected[name]
            got = actual[name] if name in actual else getattr(film, name)
            with np.errstate(over="ignore"):
                size = np.maximum(np.abs(picture), size * (1e-7 if name == "standard_error" else 1.0))
                allowed = tolerances.get(name, 1e-6) * size + 1e-43  # floats end at 1e-45
                if name == "mean":  # what is far below the brightest is lost beside it, in floats
                    allowed += 1e-30 * np.abs(picture).max()
            same = np.isinf(picture) & (got == picture)
            with np.errstate(invalid="ignore"):
                same |= np.abs(got - picture) <= allowed
            wrong = np.argwhere(~same)
            if len(wrong):
                place = tuple(wrong[0])
                what = f"{got[place]}, expected {picture[place]} +- {allowed[place]}"
                raise AssertionError(f"{name} at {place}, one of {len(wrong)}: {what}")


def scrambles(sampler: Sampler) -> np.ndarray:
    """The scramble of each pixel's first sequence, (pixels,): that of a uniform sampler of the same size and seed."""
    uniform = Sampler(sampler.width, sampler.height, Budget(spp=1), Config.uniform(batch=2**31), seed=sampler.seed)
    batch = uniform.ask()
    result = np.zeros(sampler.width * sampler.height, np.uint32)
    result[batch.pixel] = batch.scramble
    return result


def from_pool(sampler: Sampler, samples: Any) -> np.ndarray:
    """Which of some samples are the pool's: the reserved first points of the first sequence, and another sequence."""
    first = samples.scramble == scrambles(sampler)[samples.pixel]
    result: np.ndarray = ~first | (samples.index < sampler._native.reserved)
    return result


# --- Driving and comparing -------------------------------------------------------------------------------------------
def shuffled(sampler: Sampler, radiance: Radiance, rng: np.random.Generator, until: int | None = None) -> list[Batch]:
    """Asks and tells at random, as many open and in any order as there may be; what is left open at the end."""
    open_: list[Batch] = []
    while not sampler.done and (until is None or sampler.samples < until):
        if (batch := asked_or_taken(sampler, open_, rng, 0.7)) is not None:
            sampler.tell(batch, radiance(batch))
    return open_


def asked_or_taken(sampler: Sampler, open_: list[Batch], rng: np.random.Generator, asks: float) -> Batch | None:
    """One more batch among the open ones, at the odds `asks`; else, or where there is none to be had, one of them."""
    if not open_ or rng.random() < asks:
        try:
            open_.append(sampler.ask())
            return None
        except RuntimeError:
            assert open_, "nothing is open, and still ask refuses"
    return open_.pop(rng.integers(len(open_)))


def state(sampler: Sampler) -> dict[str, bytes]:
    """All that a sampler would save, but for the clock."""
    return {name: block.tobytes() for name, block in sampler._native.save().items() if name != "sampler.seconds"}


def pictures(sampler: Sampler) -> dict[str, bytes]:
    """Every picture of the film, bit for bit."""
    film = sampler.film
    names = ("mean", "plain_mean", "pool_mean", "standard_error", "samples", "strategy", "beta", "alpha", "aovs")
    images = {name: getattr(film, name) for name in names}
    images["first"], images["second"] = film.halves
    images["counts"] = np.array([sampler.samples, sampler.rejected])
    return {name: image.tobytes() for name, image in images.items()}


RUNNING = np.dtype([("n", "f4"), ("mean", "f4"), ("m2", "f4")])
MEMBER = np.dtype(
    [("x", "f4"), ("y", "f4"), ("alpha", "f4", 3), ("rounds", "u4"), ("all", RUNNING), ("kernel", RUNNING, 3)]
)


def members(sampler: Sampler, population: int = 0) -> np.ndarray:
    """A population as it would be saved."""
    return sampler._native.save()[f"population{population}.members"].view(MEMBER)


def proposals(sampler: Sampler) -> tuple[np.ndarray, np.ndarray]:
    """Of the one open batch: where each proposal of the population lies in it, and each sample's kernel, 3 for none."""
    blocks = sampler._native.save()
    return blocks["untold0.place"].view(np.uint32), blocks["untold0.tag"] & 3


@pytest.fixture(scope="session")
def twin() -> SimpleNamespace:
    return SimpleNamespace(
        hash32=hash32, mix=mix, sobol_pair=sobol_pair, reverse_bits=reverse_bits, owen_reversed=owen_reversed
    )


@pytest.fixture(scope="session")
def renderers() -> SimpleNamespace:
    return SimpleNamespace(
        noise=noise,
        rgb=rgb,
        constant=constant,
        black=black,
        textured=textured,
        spikes=spikes,
        right_half=right_half,
    )


@pytest.fixture(scope="session")
def oracle() -> type[Oracle]:
    return Oracle


@pytest.fixture(scope="session")
def tools() -> SimpleNamespace:
    return SimpleNamespace(
        shuffled=shuffled,
        asked_or_taken=asked_or_taken,
        state=state,
        pictures=pictures,
        from_pool=from_pool,
        scrambles=scrambles,
        members=members,
        proposals=proposals,
    )
