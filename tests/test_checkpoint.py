"""The checkpoint file: what is refused, what is left behind when writing fails, and that it holds data only. All exact.

That a resumed sampler goes on to the same bits is tested in sampler/test_determinism.py.
"""

from __future__ import annotations

import copy
import io
import json
import os
import pickle
import re
import resource
import subprocess
import sys
import tempfile
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmc_sampler import Batch, Budget, Config, Sampler


def image(batch: Batch) -> np.ndarray:
    value = (batch.pixel * np.uint32(2654435761) ^ batch.index * np.uint32(40503)) / np.float32(2**32)
    return np.repeat(value[:, None], 3, axis=1).astype(np.float32)


def half_done() -> Sampler:
    """Batches open, and one told out of turn."""
    sampler = Sampler(20, 15, Budget(spp=20), Config(initial_spp=2.0, batch=200, lookahead=2), seed=3, aovs=0)
    while sampler.samples < 1500:
        batch = sampler.ask()
        sampler.tell(batch, image(batch))
    sampler.ask()
    later = sampler.ask()
    sampler.tell(later, image(later))
    return sampler


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("saved") / "a checkpoint"
    half_done().save(path)
    return path


def rewritten(source: Path, target: Path, change: Callable[[dict[str, np.ndarray]], None]) -> Path:
    """A checkpoint as a whole file, but of changed blocks."""
    with np.load(source) as archive:
        blocks = {name: archive[name] for name in archive.files}
    change(blocks)
    with target.open("wb") as file:
        np.savez(file, **blocks)
    return target


def header(change: Callable[[dict[str, Any]], None]) -> Callable[[dict[str, np.ndarray]], None]:
    """A change of the header alone."""

    def apply(blocks: dict[str, np.ndarray]) -> None:
        values = json.loads(blocks["header"].tobytes())
        change(values)
        blocks["header"] = np.frombuffer(json.dumps(values).encode(), np.uint8)

    return apply


def test_what_a_file_holds(saved: Path) -> None:
    """Bytes and JSON: an .npz that NumPy reads without pickle, and the settings in words."""
    with np.load(saved, allow_pickle=False) as archive:
        assert all(archive[name].dtype == np.uint8 for name in archive.files)
        values = json.loads(archive["header"].tobytes())
    assert values["format"] == "pmc_sampler checkpoint"
    assert (values["width"], values["height"], values["seed"]) == (20, 15, 3)
    assert Config.from_dict(values["config"]) == Config(initial_spp=2.0, batch=200, lookahead=2)


def test_everything_given_is_restored(tmp_path: Path) -> None:
    config = Config.paper(40, 30, population=30, radii=(2.0, 3.0), filter="tent")
    sampler = Sampler(40, 30, Budget(spp=9, seconds=1e6, visible_noise=0.01), config, seed=2**64 - 1, aovs=3)
    batch = sampler.ask()
    sampler.tell(batch, np.ones((len(batch), 6), np.float32))
    sampler.save(str(tmp_path / "state"))
    again = Sampler.load(str(tmp_path / "state"))
    for name in ("width", "height", "budget", "config", "seed", "aovs", "samples", "rejected", "done"):
        assert getattr(again, name) == getattr(sampler, name), name
    assert again.elapsed >= 0
    assert np.array_equal(again.film.aovs, sampler.film.aovs)


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
@pytest.mark.parametrize("block", ["film.score", "film.tiles"])
def test_weights_that_no_samples_give_are_refused(block: str, value: float) -> None:
    """They are whole, but not ours: drawing by them would lead anywhere."""
    sampler = Sampler(40, 30, Budget(spp=20), Config(initial_spp=2, batch=400), seed=1)
    for _ in range(8):
        batch = sampler.ask()
        sampler.tell(batch, np.random.default_rng(batch.number).random((len(batch), 3), np.float32))
    blocks = {name: data.copy() for name, data in sampler._native.save().items()}
    Sampler(40, 30, Budget(spp=20), sampler.config, seed=1)._native.restore(blocks)
    blocks[block].view(np.float32 if block == "film.score" else np.float64)[0] = value
    with pytest.raises(RuntimeError, match="film is damaged: it has weights that no samples give"):
        Sampler(40, 30, Budget(spp=20), sampler.config, seed=1)._native.restore(blocks)


def test_a_finished_sampler_stays_finished(tmp_path: Path) -> None:
    for budget in (Budget(spp=2), Budget(seconds=1e-9), Budget(visible_noise=0.5)):
        sampler = Sampler(20, 15, budget)
        sampler.run(lambda batch: np.ones((len(batch), 3), np.float32))
        sampler.save(tmp_path / "state")
        assert Sampler.load(tmp_path / "state").done == sampler.done is not None


# --- Files that are none ---------------------------------------------------------------------------------------------
def test_no_file(tmp_path: Path) -> None:
    for path in (tmp_path / "nothing", tmp_path):
        with pytest.raises(FileNotFoundError, match=re.escape(f"no checkpoint at {str(path)!r}")):
            Sampler.load(path)


def test_every_truncation(saved: Path, tmp_path: Path) -> None:
    whole = saved.read_bytes()
    cut = tmp_path / "cut"
    for length in (0, 1, 3, 4, 30, 100, 1000, len(whole) // 2, len(whole) - 200, len(whole) - 22, len(whole) - 1):
        cut.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=f"{re.escape(repr(str(cut)))} is no whole pmc_sampler checkpoint"):
            Sampler.load(cut)


def test_flipped_bits(saved: Path, tmp_path: Path) -> None:
    """Wherever they are, either the archive's checksums tell, or they were in what says nothing (dates, padding)."""
    whole = saved.read_bytes()
    damaged = tmp_path / "damaged"
    expected = {name: block.tobytes() for name, block in Sampler.load(saved)._native.save().items()}
    told = 0
    directory = len(whole) - 2000  # of the archive, at the end: what its members are and where
    places = [*np.linspace(0, directory, 100).astype(int), *range(directory, len(whole), 10)]
    for place in places:
        content = bytearray(whole)
        content[place] ^= 0x10
        damaged.write_bytes(content)
        try:
            again = Sampler.load(damaged)
        except ValueError as error:
            told += repr(str(damaged)) in str(error)
        else:
            assert {name: block.tobytes() for name, block in again._native.save().items()} == expected
            told += 1
    assert told == len(places)


class Trap:
    """Unpickled, it would write a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.path,))


def other_files(folder: Path) -> dict[str, bytes]:
    """Files that are not checkpoints, some of them malign."""
    npz, pickled, single, plain_zip = io.BytesIO(), io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.savez(npz, image=np.ones(3))
    np.savez(pickled, header=np.array([Trap(folder / "trapped")], object))
    np.save(single, np.ones(3))
    with zipfile.ZipFile(plain_zip, "w") as archive:
        archive.writestr("header.npy", "text")
        archive.writestr("other.txt", "text")
    return {
        "other npz": npz.getvalue(),
        "pickled npz": pickled.getvalue(),
        "npy": single.getvalue(),
        "zip": plain_zip.getvalue(),
        "pickle": pickle.dumps(Trap(folder / "trapped")),
        "text": b"width = 20\n",
        "png": b"\x89PNG\r\n\x1a\n" + bytes(100),
    }


@pytest.mark.parametrize("kind", ["other npz", "pickled npz", "npy", "zip", "pickle", "text", "png"])
def test_foreign_files(kind: str, tmp_path: Path) -> None:
    """Refused as what they are, and nothing in them is executed."""
    path = tmp_path / "foreign"
    path.write_bytes(other_files(tmp_path)[kind])
    with pytest.raises(ValueError, match=f"{re.escape(repr(str(path)))} is no whole pmc_sampler checkpoint"):
        Sampler.load(path)
    assert not (tmp_path / "trapped").exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (header(lambda h: h.update(version=99)), "is a checkpoint of version 99: this version of pmc_sampler reads"),
        (header(lambda h: h.pop("version")), "is a checkpoint of version None"),
        (header(lambda h: h.update(format="x")), "its header is not a checkpoint's"),
        (header(lambda h: h.pop("width")), "cannot resume .* 'width'"),
        (header(lambda h: h.update(width=40)), "cannot resume .* block 'film"),
        (header(lambda h: h.update(width=65535, height=65535)), "cannot resume .* of 65535x65535 takes"),
        (header(lambda h: h.update(note=7)), "cannot resume"),
        (header(lambda h: h.update(width=0)), "cannot resume .* width is 0: expected 1 to 65535"),
        (header(lambda h: h.update(width="20")), "cannot resume .* width is '20'"),
        (header(lambda h: h.update(aovs=2)), "cannot resume .* block 'film.aov_sums' holds 0 bytes, expected"),
        (header(lambda h: h.update(budget=[1])), "cannot resume"),
        (header(lambda h: h.update(budget={})), "cannot resume .* the budget has no limit"),
        (header(lambda h: h.update(config=7)), "cannot resume .* settings are 7"),
        (header(lambda h: h["config"].update(moves=-1)), "cannot resume .* moves is -1"),
        (header(lambda h: h["config"].update(moves=9)), "cannot resume .* batch 8 is damaged"),
        (header(lambda h: h["config"].update(lookahead=5)), "cannot resume .* no block 'population3.members'"),
        (lambda b: b.update(header=np.frombuffer(b"[1]", np.uint8)), "no whole pmc_sampler checkpoint"),
        (lambda b: b.update(header=np.frombuffer(b"{", np.uint8)), "no whole pmc_sampler checkpoint"),
        (lambda b: b.update(header=np.frombuffer(b"\xff\xfe", np.uint8)), "no whole pmc_sampler checkpoint"),
        (lambda b: b.update({"film.sums": b["film.sums"][:-1]}), "block 'film.sums' holds .* bytes, expected"),
        (lambda b: b.update({"film.sums": b["film.sums"].astype(np.float32)}), "a block does not hold bytes"),
        (lambda b: b.update({"film.sums": b["film.sums"].reshape(-1, 8)}), "a block does not hold bytes"),
        (lambda b: b.pop("film.sums"), "has no block 'film.sums'"),
        (lambda b: b.pop("untold0.slot"), "has no block 'untold0.slot'"),
        (lambda b: b.pop("waiting0.radiance"), "has no block 'waiting0.radiance'"),
    ],
)
def test_whole_files_of_other_content(change: Any, sentence: str, saved: Path, tmp_path: Path) -> None:
    path = rewritten(saved, tmp_path / "other", change)
    with pytest.raises(ValueError, match=sentence) as caught:
        Sampler.load(path)
    assert repr(str(path)) in str(caught.value)


def patched(name: str, values: Any, kind: Any) -> Callable[[dict[str, np.ndarray]], None]:
    """The first elements of a block overwritten."""

    def apply(blocks: dict[str, np.ndarray]) -> None:
        block = blocks[name].copy()
        array = block.view(kind)
        array[: np.size(values)] = values
        blocks[name] = block

    return apply


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (patched("untold0.slot", 2**31, np.uint32), "batch 8 is damaged"),
        (patched("untold0.slot", [511, 0], np.uint32), "batch 8 is damaged"),
        (patched("untold0.place", 2**31, np.uint32), "batch 8 is damaged"),
        (patched("untold0.tag", [255] * 9, np.uint8), "batch 8 is damaged"),
        (patched("untold0.evaluated", 2**31, np.uint32), "batch 8 is damaged"),
        (patched("untold0.iteration_samples", 2**40, np.uint64), "batch 8 is damaged"),
        (patched("batches.untold", 2**60, np.uint64), "number of open batches is damaged"),
        (patched("population0.members", [np.nan, 1.0], np.float32), "a member lies outside the image"),
        (patched("population0.members", [1.0, 1e9], np.float32), "a member lies outside the image"),
        (lambda b: b.update({"population0.members": b["population0.members"][:-5]}), "members' is damaged"),
        (lambda b: b.update({"population0.members": b["population0.members"][:72]}), "batch .* is damaged"),
        (lambda b: b.update({"waiting0.radiance": b["waiting0.radiance"][:-4]}), "radiance of batch 9 is damaged"),
        (lambda b: b.update({"untold0.pixel": b["untold0.pixel"][:-4]}), "batch 8 is damaged"),
    ],
)
def test_blocks_that_would_lead_outside_their_arrays(change: Any, sentence: str, saved: Path, tmp_path: Path) -> None:
    path = rewritten(saved, tmp_path / "damaged", change)
    with pytest.raises(ValueError, match=f"cannot resume .*{sentence}"):
        Sampler.load(path)


def npy(shape: str, data: bytes) -> bytes:
    """A part of an archive whose header says what it likes."""
    text = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


@pytest.mark.parametrize(
    ("part", "compression", "sentence"),
    [
        (npy("(1000000000, 1000000000)", b""), zipfile.ZIP_STORED, "a part of 0 bytes should hold uint8 of shape"),
        (npy("(-1, -1)", b"x"), zipfile.ZIP_STORED, "no whole pmc_sampler checkpoint"),
        (npy("(0, 10**99)", b""), zipfile.ZIP_STORED, "no whole pmc_sampler checkpoint"),
        (npy("__import__('os').getpid(),", b""), zipfile.ZIP_STORED, "no whole pmc_sampler checkpoint"),
        (npy("(10000000,)", bytes(10**7)), zipfile.ZIP_DEFLATED, "it is compressed"),
    ],
    ids=["10^18 bytes", "negative", "empty and vast", "code", "a thousandfold"],
)
def test_archives_that_promise_too_much(part: bytes, compression: int, sentence: str, tmp_path: Path) -> None:
    """Refused before memory is taken: 10 MB at the most were needed for the last."""
    path = tmp_path / "bomb"
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr("header.npy", part)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=sentence):
            Sampler.load(path)
        assert tracemalloc.get_traced_memory()[1] < 10**6
    finally:
        tracemalloc.stop()


def test_parts_that_share_their_bytes(tmp_path: Path) -> None:
    """A directory that names the same bytes over and over holds more than the file: refused by the sum."""
    path = tmp_path / "bomb"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.npy", npy("(1000,)", bytes(1000)))
        first = archive.filelist[0]
        for k in range(50):
            archive.filelist.append(copy.copy(first))
            archive.filelist[-1].filename = f"{k}.npy"
        archive._didModify = True
    with pytest.raises(ValueError, match="its parts are larger than the file"):
        Sampler.load(path)


# --- Writing ---------------------------------------------------------------------------------------------------------
def test_saving_changes_nothing(tmp_path: Path) -> None:
    sampler = half_done()
    before = {name: block.tobytes() for name, block in sampler._native.save().items() if name != "sampler.seconds"}
    sampler.save(tmp_path / "state")
    after = {name: block.tobytes() for name, block in sampler._native.save().items() if name != "sampler.seconds"}
    assert before == after


def test_saving_replaces_and_leaves_no_other_file(tmp_path: Path) -> None:
    path = tmp_path / "state"
    path.write_text("an old file")
    half_done().save(path)
    sampler = half_done()
    sampler.save(path)
    assert Sampler.load(path).samples == sampler.samples
    assert os.listdir(tmp_path) == ["state"]


@pytest.mark.parametrize("where", ["missing/state", "file/state", "folder"])
def test_nowhere_to_write(where: str, tmp_path: Path) -> None:
    """A folder that is missing, that is a file; a file that is a folder."""
    (tmp_path / "file").write_text("a file")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match=re.escape(where.split("/")[0])):
        half_done().save(tmp_path / where)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]
    assert (tmp_path / "file").read_text() == "a file"
    assert os.listdir(tmp_path / "folder") == []


@pytest.mark.parametrize("where", ["folder", ""])
def test_a_folder_is_no_file(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty name is that of the working folder."""
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)
    sentence = f"'{where or '.'}' cannot be written: it is a folder; name a file"
    with pytest.raises(IsADirectoryError, match=f"^{re.escape(sentence)}$"):
        half_done().save(where)
    assert os.listdir(tmp_path) == ["folder"]
    assert os.listdir(tmp_path / "folder") == []


def test_a_folder_that_is_read_only() -> None:
    """Root may write anywhere, and so it becomes somebody else for the time."""
    with tempfile.TemporaryDirectory() as name:  # not tmp_path, whose parents are closed to others
        folder, user = Path(name), os.geteuid()
        path = folder / "state"
        half_done().save(path)
        before = path.read_bytes()
        folder.chmod(0o555)
        if user == 0:
            os.seteuid(65534)
        try:
            with pytest.raises(PermissionError, match="state"):
                half_done().save(path)
        finally:
            os.seteuid(user)
            folder.chmod(0o700)
        assert path.read_bytes() == before
        assert os.listdir(folder) == ["state"]


def test_a_full_disk_leaves_the_old_file(saved: Path, tmp_path: Path) -> None:
    """As it seems to a process that may write no more than 10 kB: an error, the old checkpoint whole, nothing else."""
    path = tmp_path / "state"
    path.write_bytes(saved.read_bytes())
    program = (
        "import sys; from pmc_sampler import Sampler\n"
        "try: Sampler.load(sys.argv[1]).save(sys.argv[1])\n"
        "except OSError as error: print('refused:', error)"
    )
    process = subprocess.run(
        [sys.executable, "-P" if sys.version_info >= (3, 11) else "-E", "-B", "-c", program, str(path)],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000)),
        check=True,
    )
    assert process.stdout.startswith("refused: ")
    assert path.read_bytes() == saved.read_bytes()
    assert os.listdir(tmp_path) == ["state"]
