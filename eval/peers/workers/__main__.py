"""Runs a peer for :mod:`pmc_sampler.eval.peers.process`: ``python workers PACKAGE``, by a Python that has it.

Reads pickled values on standard input: a scene, then settings; writes one for each on standard output: what the peer
is called and its version, then what it rendered, or its error. Ends where its input ends.
"""

import importlib
import importlib.util
import os
import pickle
import sys
from pathlib import Path
from typing import Any

PRELOADED = "PMC_PEER_PRELOADED"
COMMON = {"samples", "seed", "file"}


def main(package: str) -> None:
    """Answer until the input ends."""
    # Renderers chatter on standard output, also from C++.
    with os.fdopen(os.dup(1), "wb") as replies:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        peer: Any = None
        while True:
            try:
                asked = pickle.load(sys.stdin.buffer)
                if peer is None:
                    peer = importlib.import_module(f"with_{package}").Peer(asked)
                    reply = peer.version
                elif unknown := asked.keys() - COMMON - set(peer.settings):
                    raise ValueError(f"{', '.join(sorted(unknown))} came; settings are {', '.join(peer.settings)}")
                else:
                    reply = peer.render(asked)
            except EOFError:
                break
            except ImportError as error:
                reply = error
            except Exception as error:  # whatever a renderer raises, in a class that the other side has too
                reply = RuntimeError(f"{type(error).__name__}: {error}")
            pickle.dump(reply, replies)
            replies.flush()
    os._exit(0)  # without the libraries' destructors: LuxCore's abort


def preload(package: str) -> None:
    """Start again with the memory manager that a package brings with it in place from the beginning.

    LuxCore's takes over the C library's when it is loaded, so that what was allocated before is freed by the wrong
    one: on some machines its renders abort ("double free or corruption").
    """
    spec = importlib.util.find_spec(package)
    if PRELOADED in os.environ or spec is None or spec.origin is None:
        return
    folder = Path(spec.origin).parent.with_name(f"{package}.libs")
    # By name, for paths with spaces: the folder is searched.
    found = sorted(path.name for path in folder.glob("libtbbmalloc*.so*"))
    if found:
        libraries = " ".join(filter(None, [os.environ.get("LD_PRELOAD"), *found]))
        path = os.pathsep.join(filter(None, [str(folder), os.environ.get("LD_LIBRARY_PATH")]))
        preloaded = {"LD_PRELOAD": libraries, "LD_LIBRARY_PATH": path, PRELOADED: "1"}
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **preloaded})


if __name__ == "__main__":
    preload(sys.argv[1])
    main(sys.argv[1])
