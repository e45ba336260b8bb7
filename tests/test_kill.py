"""SIGKILL at any moment of a render that keeps checkpoints: nothing is damaged, and the image has the same bits. Exact.

Which moments are hit is random. A process is forked from one that has the package imported, and so a kill costs
milliseconds; it saves after each batch, so that most of its time goes into writing, and the kills meet that, too.
"""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pmc_sampler.eval import images

KILLS = 100

PROGRAM = """
import json, os, random, signal, sys, time
from pathlib import Path
import numpy as np
from pmc_sampler import Budget, Config, Sampler
path, kills = Path(sys.argv[1]), int(sys.argv[2])

def image(batch):
    value = (batch.pixel * np.uint32(2654435761) ^ batch.index * np.uint32(40503)) / np.float32(2**32)
    return np.repeat(value[:, None], 3, axis=1).astype(np.float32)

def fresh():
    return Sampler(64, 48, Budget(spp=40), Config(batch=2000, lookahead=1), seed=7, threads=1)

def render(sampler, save):
    while not sampler.done:
        batch = sampler.ask()
        sampler.tell(batch, image(batch))
        if save:
            sampler.save(path)
    return sampler

def child():
    render(Sampler.load(path, threads=1) if path.exists() else fresh(), True)
    os._exit(0)

whole = render(fresh(), False)
chance = random.Random(int(sys.argv[3]))
killed, writing, before, rounds = 0, 0, 0, []
while True:
    pid = os.fork()
    if pid == 0:
        child()
    if killed < kills:
        time.sleep(chance.uniform(0.0, 0.04))
        os.kill(pid, signal.SIGKILL)
    _, status = os.waitpid(pid, 0)
    if os.waitstatus_to_exitcode(status) == 0:
        same = Sampler.load(path).film.mean.tobytes() == whole.film.mean.tobytes()
        rounds.append(same)
        if killed >= kills:
            break
        path.unlink()  # the next begins anew
        before = 0
        continue
    killed += 1
    for left in path.parent.glob("state.*.part"):
        writing += 1
        left.unlink()
    if path.exists():
        samples = Sampler.load(path, threads=1).samples  # raises where it is damaged
        assert samples >= before, (samples, before)
        before = samples
print(json.dumps({"killed": killed, "while it was written": writing, "renders with the same bits": rounds}))
"""


@pytest.mark.parametrize("seed", [1])
def test_killed_at_random_moments(seed: int, tmp_path: Path) -> None:
    words = [sys.executable, "-c", PROGRAM, str(tmp_path / "state"), str(KILLS), str(seed)]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["killed"] == KILLS
    assert found["while it was written"] > 0
    assert found["renders with the same bits"]
    assert all(found["renders with the same bits"])
    print(found)


@pytest.mark.long
@pytest.mark.needs("pyopencl", "mitsuba", "OpenImageIO")
def test_the_command_killed_at_random_moments(tmp_path: Path) -> None:
    """`pmc-sampler render`, killed ten times between its start and what is a little more than its whole work."""
    command = str(Path(sys.executable).with_name("pmc-sampler"))
    words = [command, "render", "cornell-box", "--size", "320x240", "--spp", "40", "--checkpoint-every", "0.01"]
    began = time.monotonic()
    subprocess.run([*words, "-o", "whole.exr"], cwd=tmp_path, check=True, capture_output=True)
    whole, chance, killed, states = time.monotonic() - began, random.Random(1), 0, 0
    while killed < 10:
        process = subprocess.Popen([*words, "-o", "a.exr"], cwd=tmp_path, stdout=subprocess.DEVNULL)
        time.sleep(chance.uniform(0.0, whole))
        process.kill()
        killed += process.wait() == -signal.SIGKILL
        states += (tmp_path / "a.exr.checkpoint").exists()
    subprocess.run([*words, "-o", "a.exr"], cwd=tmp_path, check=True, capture_output=True)
    assert states > 0
    assert (images.read(tmp_path / "a.exr").rgb == images.read(tmp_path / "whole.exr").rgb).all()
    assert not list(tmp_path.glob("a.exr.checkpoint*"))
    print(f"{killed} kills, {states} of them with a state to go on from, in a render of {whole:.1f} s")
