"""The process in which `frenetic bench` runs a generator, started as a script.

It talks with the bench through its original stdin and stdout. It puts those aside first, so nothing
that a generator prints or reads gets in between.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from typing import BinaryIO

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Take the streams, then follow the bench."""
    incoming, outgoing = take_streams()
    import_frenetic()
    from frenetic.bench.hosting.host import serve  # only now can it be found

    serve(incoming, outgoing)


def take_streams() -> tuple[BinaryIO, BinaryIO]:
    """Return the original stdin and stdout; they become an empty file and stderr."""
    incoming = os.fdopen(os.dup(0), "rb")  # a duplicate is not passed on to other programs
    outgoing = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    for stream in (sys.stdout, sys.stderr):
        # In every locale: a generator must not fail at its output.
        stream.reconfigure(  # type: ignore[union-attr]
            encoding="utf-8", errors="backslashreplace", line_buffering=True
        )
    return incoming, outgoing


def import_frenetic() -> None:
    """Make the `frenetic` of this file importable, and nothing else beside it."""
    # Python puts a script's folder first: its modules would shadow the generator's.
    sys.path[:] = [entry for entry in sys.path if not entry or Path(entry).resolve() != HERE]
    package = HERE.parents[1]
    spec = importlib.util.spec_from_file_location(
        "frenetic", package / "__init__.py", submodule_search_locations=[str(package)]
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["frenetic"] = module
    spec.loader.exec_module(module)


if __name__ == "__main__":
    main()
elif __name__ == "__mp_main__":  # a process that a generator has started with multiprocessing
    import_frenetic()
    from frenetic.bench.hosting.pipeline import Unused

    sys.meta_path.append(Unused())
