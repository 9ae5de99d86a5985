"""Records of what slow references have agreed with, so that they are not run again.

A reference, such as another program or a slow reader, checks what Frenetic makes. While its inputs
stay the same byte for byte, the check is skipped. `pytest --all -m endurance` runs every check and
writes down the digests of the inputs that passed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "agreements"
"""Folder with one file per test file; each line is a digest and a name."""


class Agreements:
    """Digests of the inputs that passed the checks of one test file."""

    def __init__(self, file: Path, *, anew: bool) -> None:
        self._file = file
        self._anew = anew

    @contextmanager
    def upon(self, name: str, *parts: str | bytes) -> Iterator[bool]:
        """Run a check inside `with`, and record it if it passes.

        Yields:
            Whether the check passed before on the same parts, so that it may be skipped.
        """
        hashed = sha256()
        for part in parts:
            data = part.encode() if isinstance(part, str) else part
            hashed.update(b"%d:%b" % (len(data), data))
        digest = hashed.hexdigest()
        yield not self._anew and self._digests().get(name) == digest
        if self._anew:
            digests = self._digests() | {name: digest}
            lines = [f"{digests[key]} {key}\n" for key in sorted(digests)]
            self._file.write_text("".join(lines), encoding="utf-8")

    def _digests(self) -> dict[str, str]:
        if not self._file.exists():
            return {}
        lines = self._file.read_text(encoding="utf-8").splitlines()
        return {name: digest for digest, name in (line.split(" ", 1) for line in lines)}
