"""The pipeline's modules, under the pipeline's names.

They take precedence over a copy of the pipeline on the module path; modules that only the copy has
are found there.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import sys

from frenetic.bench.hosting.offered import code_pipeline, self_driving

PACKAGES = {"code_pipeline": code_pipeline, "self_driving": self_driving}
MODULES = tuple(
    importlib.import_module(f"{package.__name__}.{module.name}")
    for package in PACKAGES.values()
    for module in pkgutil.iter_modules(package.__path__)
)


def install() -> None:
    """Make the modules importable; the module path must be set by then."""
    for name, package in PACKAGES.items():
        package.__path__ = pkgutil.extend_path(package.__path__, name)
        sys.modules[name] = package
    for module in MODULES:
        name = _pipeline_name(module.__name__)
        sys.modules[name] = module
        for value in vars(module).values():
            if inspect.isclass(value) and value.__module__ == module.__name__:
                value.__module__ = name  # by which it is found again, when it is unpickled


def module_names() -> list[str]:
    """Return the names of the modules, as the pipeline has them."""
    return [name for name in sys.modules if name.partition(".")[0] in PACKAGES and "." in name]


def _pipeline_name(name: str) -> str:
    return name[len(__name__) + 1 :]
