"""Agreements of slow readers and references with what we make.

While something stays as it was when they agreed with it, byte for byte, they are not asked again.
`pytest --all -m endurance` asks them about everything, and keeps the digests of what they agree
with.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "agreements"
"""Holds a file for each test file, with a digest and a name in each line."""


class Agreements:
    """What was agreed upon in a test file."""

    def __init__(self, file: Path, *, anew: bool) -> None:
        self._file = file
        self._anew = anew

    @contextmanager
    def upon(self, name: str, *parts: str | bytes) -> Iterator[bool]:
        """Around what asks for an agreement; gives whether there is one on just these parts."""
        hashed = sha256()
        for part in parts:
            data = part.encode() if isinstance(part, str) else part
            hashed.update(b"%d:%b" % (len(data), data))
        digest = hashed.hexdigest()
        yield not self._anew and self._kept().get(name) == digest
        if self._anew:
            kept = self._kept() | {name: digest}
            lines = [f"{kept[one]} {one}\n" for one in sorted(kept)]
            self._file.write_text("".join(lines), encoding="utf-8")

    def _kept(self) -> dict[str, str]:
        if not self._file.exists():
            return {}
        lines = self._file.read_text(encoding="utf-8").splitlines()
        return {name: digest for digest, name in (line.split(" ", 1) for line in lines)}
