"""Classes of the pipeline that drive BeamNG.tech: here they have names only."""

from __future__ import annotations

from typing import Any

from frenetic.errors import FreneticError


class Placeholder:
    """A class for annotations and `isinstance`.

    Raises:
        FreneticError: It is built.

    """

    def __init__(self, *_: Any, **__: Any) -> None:
        raise FreneticError(
            f"{type(self).__name__} cannot be built, as this is Frenetic's bench and not the"
            " pipeline: use the executor that the generator is given"
        )
