"""A strict type check of the Python code in README and docs, against the installed package.

The check shows that the package is typed for its users. ``python .ci/examples.py`` needs mypy.
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
"""Files that are not checked: generators of the competition's participants are untyped."""


def main() -> int:
    """Check the code of all pages, in several rounds if pages name the same file."""
    rounds: list[dict[str, str]] = []
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        files = {}
        for number, text in enumerate(BLOCK.findall(page.read_text(encoding="utf-8")), 1):
            match = NAME.match(text)
            files[match[1] if match else f"{page.stem}_{number}.py".replace("-", "_")] = text
        files = {name: text for name, text in files.items() if name not in UNTYPED}
        free_round = next((other for other in rounds if not other.keys() & files.keys()), None)
        if free_round is None:
            rounds.append(free_round := {})
        free_round |= files
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
