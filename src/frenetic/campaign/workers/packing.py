"""Driver and simulator in one parcel, for computers without the user's files."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import cloudpickle

from frenetic.campaign.tester import RoadTester
from frenetic.errors import CampaignError, describe_error
from frenetic.registry import USER_MODULE, user_files


def pack(tester: RoadTester) -> bytes:
    """The tester as a parcel with the code of the user's own modules in it.

    These are the modules in the current folder, in the folders of files that the user named, and
    these files themselves. All other imports must be installed where it is unpacked.

    Raises:
        CampaignError: driver or simulator cannot be packed.
    """
    try:
        with _by_value(own_modules()):
            parcel: bytes = cloudpickle.dumps(tester)
    except Exception as error:
        raise CampaignError(
            "the driver or simulator cannot be sent to the workers of a cluster"
            f" ({describe_error(error)}): use local workers, or make it picklable"
        ) from error
    return parcel


def own_modules() -> list[ModuleType]:
    """The user's own modules that this process has imported; packages stand for all in them."""
    folders = {Path.cwd().resolve(), *(Path(file).resolve().parent for file in user_files())}
    return [
        module
        for name, module in sys.modules.copy().items()  # another thread may be importing
        if name.startswith(USER_MODULE)
        or ("." not in name and name not in ("__main__", "frenetic") and _home(module) in folders)
    ]


def _home(module: ModuleType) -> Path | None:
    """The folder in which a module lies, or a package's folder; None if it lies in none."""
    places = list(getattr(module, "__path__", ())) or [getattr(module, "__file__", None)]
    return Path(places[0]).resolve().parent if isinstance(places[0], str) else None


@contextmanager
def _by_value(modules: list[ModuleType]) -> Iterator[None]:
    """Makes cloudpickle send the code of modules instead of their names."""
    known = cloudpickle.list_registry_pickle_by_value()
    fresh = [module for module in modules if module.__name__ not in known]
    for module in fresh:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in fresh:
            cloudpickle.unregister_pickle_by_value(module)
