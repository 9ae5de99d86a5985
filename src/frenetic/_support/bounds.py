"""Kinds of numbers, with the bounds that `msgspec.convert` checks."""

from __future__ import annotations

import sys
from typing import Annotated, Final, TypeAlias

from msgspec import Meta

_MOST: Final = sys.float_info.max

Finite: TypeAlias = Annotated[float, Meta(ge=-_MOST, le=_MOST)]
Positive: TypeAlias = Annotated[float, Meta(gt=0.0, le=_MOST)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0.0, le=_MOST)]
Measured: TypeAlias = Annotated[float, Meta(ge=-1e7, le=1e7)]
"""A length in m, a time in s: what is larger is a mistake."""
Share: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0)]
Count: TypeAlias = Annotated[int, Meta(ge=1, le=2**63 - 1)]
Index: TypeAlias = Annotated[int, Meta(ge=0, le=2**63 - 1)]
