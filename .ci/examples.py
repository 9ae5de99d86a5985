"""A strict type check of the Python on README's and the docs' pages, against the installed package.

It shows that the package is typed for its users. ``python .ci/examples.py`` needs mypy.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NAME = re.compile(r"# file: (\S+)\n")
UNTYPED = {"wiggly.py"}
"""A generator as the competition's participants write it, on modules of their pipeline."""


def main() -> int:
    """Check the pages together; those that name the same file come one after the other."""
    rounds: list[dict[str, str]] = []
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        files = {}
        for number, text in enumerate(BLOCK.findall(page.read_text(encoding="utf-8")), 1):
            named = NAME.match(text)
            files[named[1] if named else f"{page.stem}_{number}.py".replace("-", "_")] = text
        files = {name: text for name, text in files.items() if name not in UNTYPED}
        free = next((other for other in rounds if not other.keys() & files.keys()), None)
        if free is None:
            rounds.append(free := {})
        free |= files
    return max(check(files) for files in rounds)


def check(files: dict[str, str]) -> int:
    """Return mypy's exit code for these files in a folder of their own."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--cache-dir"]
        command += [str(ROOT / ".mypy_cache/examples"), "."]
        return subprocess.run(command, cwd=folder).returncode  # noqa: S603 - a checker, no shell


sys.exit(main())
