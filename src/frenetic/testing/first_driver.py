"""Files of a first driver and its test, for a user to edit."""

from __future__ import annotations

import keyword
import re
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from frenetic._support.files import write_file
from frenetic.errors import FreneticError

_MODULE: Final = "my_driver"
"""Name of the templates' module."""
_CLASS: Final = "MyDriver"
"""Name of the templates' class."""


def write_driver(path: Path) -> tuple[Path, Path, str]:
    """Write a driver that is ready to edit, and its test beside it.

    Args:
        path: path of a new file whose name Python can import, such as ``my_driver.py``.

    Returns:
        The driver's file, the test's file, and the name of the driver's class.

    Raises:
        FreneticError: the name cannot be imported, or a file exists or cannot be written.
    """
    module = path.stem
    if path.suffix != ".py" or not module.isidentifier() or keyword.iskeyword(module):
        raise FreneticError(
            f"{path.name} is no name of a Python module: letters, digits and _ before .py are"
            f" allowed, such as {_MODULE}.py"
        )
    test = path.with_name(f"test_{path.name}")
    for file in (path, test):
        if file.exists():
            raise FreneticError(f"{file} exists and is not replaced: choose another name")
    if module == "__main__" or ((spec := find_spec(module)) and spec.origin is not None):
        raise FreneticError(f"a module named {module} is there already: choose another name")
    folder = files("frenetic.testing.templates")
    templates = {
        path: folder.joinpath(f"{_MODULE}.py").read_text(encoding="utf-8"),
        # The template is no .py file, since it imports a module that is not there.
        test: folder.joinpath(f"test_{_MODULE}.txt").read_text(encoding="utf-8"),
    }
    class_name = "".join(word[:1].upper() + word[1:] for word in module.split("_")) or _CLASS
    is_taken = any(re.search(rf"\b{class_name}\b", text) for text in templates.values())
    if class_name != _CLASS and is_taken:  # the templates use the name, such as Observation
        class_name += "Driver"
    for file, text in templates.items():
        write_file(
            file,
            re.sub(rf"\b{_CLASS}\b", class_name, re.sub(rf"\b{_MODULE}\b", module, text)),
            remedy="choose another place",
            parents=True,
        )
    return path, test, class_name
