"""What drives BeamNG.tech in the pipeline, so is not to be had here."""

from __future__ import annotations

from typing import Any

from frenetic.errors import FreneticError


class OnlyByName:
    """A class for annotations and `isinstance`.

    Raises:
        FreneticError: It is built.

    """

    def __init__(self, *_: Any, **__: Any) -> None:
        raise FreneticError(
            f"{type(self).__name__} cannot be built, as this is Frenetic's bench and not the"
            " pipeline: use the executor that the generator is given"
        )
