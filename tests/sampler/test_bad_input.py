"""What bad input gets: the right exception, a sentence that names what came and what was expected, and a sampler in the
state it was in, bit for bit. Samples that are no radiance never enter the film. All exact.
"""

from __future__ import annotations

import re
import resource
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Batch, Budget, Config, Sampler


@pytest.fixture
def busy(renderers: SimpleNamespace) -> tuple[Sampler, Batch]:
    """A sampler in the middle of its work, with a batch open."""
    sampler = Sampler(20, 15, Budget(spp=20), Config(initial_spp=2.0, batch=200, lookahead=2), seed=3)
    while sampler.samples < 1500:
        batch = sampler.ask()
        sampler.tell(batch, renderers.textured(batch))
    return sampler, sampler.ask()


# --- Radiance --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("radiance", "error", "sentence"),
    [
        (
            lambda n: np.zeros((n - 1, 3), np.float32),
            ValueError,
            "shape (199, 3) for batch 8, expected (200, 3): give each sample a row, RGB first",
        ),
        (lambda n: np.zeros((n, 4), np.float32), ValueError, "shape (200, 4) for batch 8, expected (200, 3)"),
        (lambda n: np.zeros(n, np.float32), ValueError, "shape (200,) for batch 8, expected (200, 3)"),
        (lambda n: np.zeros((3, n), np.float32), ValueError, "shape (3, 200)"),
        (lambda n: 0.5, ValueError, "shape ()"),
        (lambda n: None, ValueError, "shape ()"),
        (lambda n: [[1.0, 2.0], [3.0]], ValueError, "no array for batch 8, expected shape (200, 3): give each sample"),
        (
            lambda n: np.ma.masked_less(np.zeros((n, 3), np.float32), 1),
            TypeError,
            "masked array for batch 8, expected a plain one: fill it, with NaN for what is no sample",
        ),
        (lambda n: np.zeros((n, 3), np.int32), TypeError, "type int32 for batch 8, expected float32: convert it"),
        (lambda n: np.zeros((n, 3), bool), TypeError, "type bool"),
        (lambda n: np.zeros((n, 3), complex), TypeError, "type complex128"),
        (lambda n: np.full((n, 3), "0"), TypeError, "type <U1"),
        (lambda n: np.full((n, 3), None), TypeError, "type object"),
    ],
)
def test_wrong_arrays(
    radiance: Any, error: type[Exception], sentence: str, busy: tuple[Sampler, Batch], renderers: Any, tools: Any
) -> None:
    sampler, batch = busy
    before = tools.state(sampler)
    with pytest.raises(error, match=re.escape(sentence)):
        sampler.tell(batch, radiance(len(batch)))
    assert tools.state(sampler) == before
    sampler.tell(batch, renderers.textured(batch))  # the right answer still counts


@pytest.mark.parametrize("aovs", [1, 4])
def test_missing_aovs(aovs: int, tools: SimpleNamespace) -> None:
    sampler = Sampler(20, 15, Budget(spp=2), aovs=aovs)
    batch = sampler.ask()
    with pytest.raises(
        ValueError, match=re.escape(f"got radiance of shape (600, 3) for batch 0, expected (600, {3 + aovs})")
    ):
        sampler.tell(batch, np.zeros((600, 3), np.float32))


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
def test_floats_of_every_size_and_layout_are_taken(kind: type, renderers: SimpleNamespace) -> None:
    """As float32; strided and Fortran-ordered arrays, lists and big-endian files of others too."""
    images = []
    for form in (np.asarray, np.asfortranarray, lambda a: np.repeat(a, 2, axis=0)[::2], np.ndarray.tolist):
        sampler = Sampler(20, 15, Budget(spp=6), seed=1)
        sampler.run(lambda batch, form=form: form(renderers.textured(batch).astype(kind)))
        images.append(sampler.film.mean.tobytes())
    assert len(set(images)) == 1


def test_what_float32_cannot_hold_is_rejected() -> None:
    sampler = Sampler(20, 15, Budget(spp=1), Config.uniform())
    batch = sampler.ask()
    values = np.ones((300, 3))
    values[7] = 1e39
    sampler.tell(batch, values)
    assert sampler.rejected == 1


# --- Samples that are no radiance ------------------------------------------------------------------------------------
BAD = [np.nan, np.inf, -np.inf, -1.0, -1e-30, float(np.nextafter(np.float32(0), np.float32(-1)))]


@pytest.mark.parametrize("name", ["default", "uniform", "paper"])
def test_invalid_samples_are_left_out(name: str, renderers: SimpleNamespace, oracle: Any) -> None:
    """One sample in 9 is bad in one channel; the film is what the others make of it, and all are counted."""
    configs = {"default": Config(), "uniform": Config.uniform(), "paper": Config.paper(population=60, radii=(3.0,))}
    sampler = Sampler(31, 20, Budget(spp=16), configs[name], seed=2)
    truth = oracle(sampler)

    def faulty(batch: Batch) -> np.ndarray:
        values = renderers.textured(batch)
        bad = np.flatnonzero(renderers.noise(batch, 77) < 1 / 9)
        values[bad, bad % 3] = np.resize(np.array(BAD, np.float32), len(bad))
        return values  # type: ignore[no-any-return]

    result = sampler.run(truth.watch(faulty))
    expected = truth.pictures()
    assert sampler.rejected == result.rejected == expected["rejected"] > 0
    assert sampler.samples + sampler.rejected == 16 * 31 * 20
    assert np.array_equal(sampler.film.samples, expected["samples"])
    np.testing.assert_allclose(sampler.film.plain_mean, expected["plain_mean"], rtol=1e-7)
    np.testing.assert_allclose(sampler.film.pool_mean, expected["pool_mean"], rtol=1e-5)
    np.testing.assert_allclose(sampler.film.standard_error, expected["standard_error"], rtol=1e-4)
    assert np.isfinite(sampler.film.mean).all()
    assert (sampler.film.mean >= 0).all()


def test_signs_of_zero_and_of_aovs_are_free() -> None:
    """-0 is no negative radiance; a channel after RGB may be negative, but not NaN or infinite."""
    sampler = Sampler(10, 10, Budget(spp=1), Config.uniform(), aovs=1)
    batch = sampler.ask()
    values = np.full((100, 4), -0.0, np.float32)
    values[:, 3] = -5.0
    values[3, 3], values[4, 3] = np.nan, np.inf
    sampler.tell(batch, values)
    assert (sampler.samples, sampler.rejected) == (98, 2)
    assert set(np.unique(sampler.film.aovs)) == {-5.0, 0.0}


@pytest.mark.parametrize("share", [0.5, 0.51, 1.0])
def test_mostly_invalid_batches_are_refused(
    share: float, busy: tuple[Sampler, Batch], renderers: SimpleNamespace, tools: SimpleNamespace
) -> None:
    """More than half of a batch is no accident: nothing is told, and the batch stays open for a better answer."""
    sampler, batch = busy
    before, values = tools.state(sampler), renderers.textured(batch)
    bad = round(share * len(batch))
    values[:bad, 1] = np.nan
    if share == 0.5:
        sampler.tell(batch, values)
        assert sampler.rejected == bad
        return
    with pytest.raises(ValueError, match=f"{bad} of 200 samples of batch 8 are NaN, infinite or negative"):
        sampler.tell(batch, values)
    assert tools.state(sampler) == before
    assert sampler.rejected == 0
    sampler.tell(batch, renderers.textured(batch))
    assert sampler.film.samples.sum() == sampler.samples


def test_a_small_batch_may_be_invalid_by_chance(renderers: SimpleNamespace) -> None:
    """The rest of a budget may be a single sample, and that one NaN: it is counted, as it would be in a larger batch,
    and the render ends. Where most of all samples are invalid the smallest batch is refused, too; a large one always.
    """

    def last_is_nan(batch: Batch) -> np.ndarray:
        values = renderers.textured(batch)
        if len(batch) < 64:
            values[:] = np.nan
        return values  # type: ignore[no-any-return]

    for rest in (1, 63):
        sampler = Sampler(64, 64, Budget(spp=3 + rest / 4096), seed=1)
        sampler.run(last_is_nan)
        assert (sampler.done, sampler.samples, sampler.rejected) == ("spp", 3 * 4096, rest)
    for size, before in ((1, 0), (64, 100)):
        sampler = Sampler(20, 15, Budget(spp=50), Config(batch=size), seed=1)
        for _ in range(before):
            batch = sampler.ask()
            sampler.tell(batch, renderers.textured(batch))
        batch = sampler.ask()
        with pytest.raises(ValueError, match=f"{size} of {size} samples of batch {before} are NaN"):
            sampler.tell(batch, np.full((size, 3), np.nan, np.float32))


def test_a_refused_answer_in_run_loses_nothing(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    sampler = Sampler(20, 15, Budget(spp=4), seed=1)
    with pytest.raises(ValueError, match="NaN"):
        sampler.run(lambda batch: np.full((len(batch), 3), np.nan, np.float32))
    sampler.run(renderers.textured)
    expected = Sampler(20, 15, Budget(spp=4), seed=1)
    expected.run(renderers.textured)
    assert tools.pictures(sampler) == tools.pictures(expected)


# --- Batches ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("action", ["tell", "drop", "put_back"])
@pytest.mark.parametrize("case", ["told", "dropped", "put back", "foreign", "foreign twin", "no batch"])
def test_batches_that_are_not_open(
    case: str, action: str, busy: tuple[Sampler, Batch], renderers: SimpleNamespace, tools: SimpleNamespace
) -> None:
    sampler, batch = busy
    mine, error, sentence = batch, ValueError, "batch 8 is not open: it was told or dropped already"
    if case == "told":
        sampler.tell(batch, renderers.textured(batch))
    elif case == "dropped":
        sampler.drop(batch)
    elif case == "put back":
        sampler.put_back(batch)
    elif case == "no batch":
        error, sentence, batch = TypeError, "got ndarray: expected the Batch that ask returned", batch.positions
    else:
        other = Sampler(20, 15, Budget(spp=20), sampler.config, seed=3 if case == "foreign twin" else 4)
        batch, sentence = other.ask(), "batch 0 was drawn by another sampler"
    values = np.zeros((len(batch), 3), np.float32)
    before = tools.state(sampler)
    advice = "" if case == "no batch" else "; a batch goes back once, to the sampler whose ask gave it"
    with pytest.raises(error, match=f"{sentence}{advice}$"):
        getattr(sampler, action)(batch, *([values] if action == "tell" else []))
    assert tools.state(sampler) == before
    if case in ("foreign", "foreign twin", "no batch"):
        sampler.tell(mine, renderers.textured(mine))  # still open
    sampler.run(renderers.textured)
    assert sampler.samples == 20 * 20 * 15


@pytest.mark.parametrize(
    ("action", "error", "sentence"),
    [
        (lambda s: s.add_elapsed("1"), TypeError, "seconds is '1': expected a number"),
        (lambda s: s.add_elapsed(None), TypeError, "seconds is None: expected a number"),
        (lambda s: s.add_elapsed(-1), ValueError, "seconds is -1: expected a number from 0"),
        (lambda s: s.add_elapsed(np.nan), ValueError, "seconds is nan: expected a finite number"),
        (lambda s: s.add_elapsed(np.inf), ValueError, "seconds is inf: expected a finite number"),
        (lambda s: s.run(np.zeros, timeout="a"), TypeError, "timeout is 'a': expected a number"),
        (lambda s: s.run(np.zeros, timeout=True), TypeError, "timeout is True: expected a number"),
        (lambda s: s.run(np.zeros, timeout=np.nan), ValueError, "timeout is nan: expected a finite number"),
        (lambda s: s.run(np.zeros, timeout=0), ValueError, "timeout is 0: expected seconds above 0, or None"),
        (
            lambda s: s.run(np.zeros, progress=3),
            TypeError,
            "progress is 3: expected a function of the sampler, or None",
        ),
        (lambda s: s.run(3), TypeError, "radiance is 3: expected a function"),
    ],
)
def test_calls_that_cannot_be(
    action: Any, error: type[Exception], sentence: str, busy: tuple[Sampler, Batch], tools: SimpleNamespace
) -> None:
    sampler, _ = busy
    before = tools.state(sampler)
    with pytest.raises(error, match=re.escape(sentence)):
        action(sampler)
    assert tools.state(sampler) == before


def test_asking_beyond_lookahead(busy: tuple[Sampler, Batch], tools: SimpleNamespace) -> None:
    sampler, batch = busy
    sampler.ask(), sampler.ask()
    before = tools.state(sampler)
    sentence = f"3 batches are open and lookahead is 2: tell or drop batch {batch.number} first"
    with pytest.raises(RuntimeError, match=sentence):
        sampler.ask()
    assert tools.state(sampler) == before


def test_asking_beyond_the_budget(renderers: SimpleNamespace, tools: SimpleNamespace) -> None:
    sampler = Sampler(20, 15, Budget(spp=2), Config.uniform(batch=400, lookahead=5))
    batches = [sampler.ask(), sampler.ask()]
    before = tools.state(sampler)
    with pytest.raises(RuntimeError, match="all samples of the budget are drawn and 2 batches are open"):
        sampler.ask()
    assert tools.state(sampler) == before
    for batch in batches:
        sampler.tell(batch, renderers.textured(batch))
    with pytest.raises(RuntimeError, match="the budget is spent"):
        sampler.ask()
    quiet = Sampler(20, 15, Budget(visible_noise=0.5), Config(initial_spp=4.0))
    quiet.run(renderers.constant)
    with pytest.raises(RuntimeError, match="the visible noise is within its budget"):
        quiet.ask()


# --- Construction ----------------------------------------------------------------------------------------------------
SPP = Budget(spp=1)


@pytest.mark.parametrize(
    ("arguments", "error", "sentence"),
    [
        ((0, 5, SPP), ValueError, "width is 0: expected 1 to 65535"),
        ((5, 0, SPP), ValueError, "height is 0: expected 1 to 65535"),
        ((-4, 5, SPP), ValueError, "width is -4: expected 1 to 65535"),
        ((65536, 5, SPP), ValueError, "width is 65536: expected 1 to 65535"),
        (
            (65535, 65535, SPP),
            ValueError,
            "the image is 65535x65535: expected 1 to 65535 pixels on each",
        ),
        ((2**64, 5, SPP), ValueError, f"width is {2**64}"),
        ((2.0, 5, SPP), TypeError, "width is 2.0: expected a whole number"),
        (("9", 5, SPP), TypeError, "width is '9'"),
        ((9, True, SPP), TypeError, "height is True"),
        ((9, 5, 64), TypeError, "budget is 64: expected a Budget, such as Budget(spp=64)"),
        ((9, 5, SPP, {"moves": 1}), TypeError, "config is {'moves': 1}: expected a Config"),
        ((9, 5, SPP, None, -1), ValueError, f"seed is -1: expected 0 to {2**64 - 1}"),
        ((9, 5, SPP, None, 2**64), ValueError, f"seed is {2**64}"),
        ((9, 5, SPP, None, 0.5), TypeError, "seed is 0.5"),
        ((9, 5, SPP, None, 0, -1), ValueError, "aovs is -1: expected 0 to 64"),
        ((9, 5, SPP, None, 0, 65), ValueError, "aovs is 65"),
        ((9, 5, SPP, None, 0, 0, 0), ValueError, "threads is 0: expected 1 to 1024"),
        ((9, 5, SPP, None, 0, 0, 1, "no"), TypeError, "signed is 'no': expected True or False"),
        (
            (9, 5, SPP, Config(radii=(3.0, 9.5))),
            ValueError,
            "radii holds 9.5 pixels, beyond the image of 9x5",
        ),
        ((9, 5, SPP, Config(population=46)), ValueError, "population is 46, more than the 45 pixels of the 9x5 image"),
    ],
)
def test_samplers_that_cannot_be(arguments: tuple[Any, ...], error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=re.escape(sentence)):
        Sampler(*arguments)


def test_sizes_as_numpy_has_them() -> None:
    sampler = Sampler(np.int64(9), np.uint16(5), SPP, seed=np.uint64(2**64 - 1))  # type: ignore[arg-type]
    assert (sampler.width, sampler.height, sampler.seed) == (9, 5, 2**64 - 1)


def test_uniform_sampling_has_no_kernel_to_check() -> None:
    sampler = Sampler(9, 5, SPP, Config.uniform(radii=(100.0,), population=1000))
    assert len(sampler.ask()) > 0


def test_more_memory_than_there_is() -> None:
    """In a process that may have 2 GiB."""
    program = "from pmc_sampler import Budget, Sampler\nSampler(20000, 20000, Budget(spp=1))"
    process = subprocess.run(
        [sys.executable, "-P" if sys.version_info >= (3, 11) else "-E", "-c", program],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31)),
        check=False,
    )
    assert process.returncode == 1
    assert "MemoryError: an image of 20000x20000 needs 35.0 GiB of film, more than there is" in process.stderr


def test_numbers_that_no_float_can_hold() -> None:
    for make in (lambda huge: Budget(spp=huge), lambda huge: Config(white_luminance=huge)):
        with pytest.raises(ValueError, match="is too large: expected a number that a float can hold"):
            make(10**400)


def test_numpy_s_booleans_are_booleans() -> None:
    assert Sampler(4, 4, Budget(spp=1), signed=np.True_).signed is True  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="expected a number"):
        Budget(spp=np.True_)  # type: ignore[arg-type]
