"""What analyses keep in a campaign's folder: JSON files, of which nothing is believed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from frenetic._support.files import write_file
from frenetic.campaign.store import JSONValue
from frenetic.errors import CampaignError

T = TypeVar("T")


@dataclass(frozen=True)
class KeptFile:
    """A file in a campaign's folder that holds a list of items."""

    name: str
    key: str
    """Of the list in the file's JSON object."""
    version: int
    """Of its form."""
    maker: str
    """The command that makes it."""

    def write(self, folder: Path, items: Sequence[JSONValue]) -> Path:
        """Writes the items in place of what was there; returns the file.

        Raises:
            CampaignError: it cannot be written.
        """
        path = folder / self.name
        document = {"version": self.version, self.key: items}
        write_file(
            path,
            json.dumps(document, allow_nan=False) + "\n",
            remedy="check the permissions of the folder",
            error=CampaignError,
            durable=True,
        )
        return path

    def read(self, folder: Path, read_item: Callable[[Any], T]) -> list[T]:
        """Reads the items, each with ``read_item``; none if there is no file.

        Raises:
            CampaignError: it cannot be read, is damaged, or was written by a newer version.
        """
        path = folder / self.name
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise CampaignError(f"{path} cannot be read: {error.strerror or error}") from None
        except (ValueError, RecursionError):
            raise self._damaged(path, "it is not JSON") from None
        version = document.get("version") if isinstance(document, dict) else None
        if isinstance(version, int) and version > self.version:
            raise CampaignError(
                f"{path} was written by a newer version of frenetic (form {version}, this one reads"
                f" {self.version}): upgrade frenetic"
            )
        try:
            if version != self.version:
                raise ValueError(f"its version is {version!r}")
            return [read_item(item) for item in document[self.key]]
        except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as error:
            raise self._damaged(path, f"{type(error).__name__}: {error}") from None
        except CampaignError as error:
            raise self._damaged(path, str(error)) from None

    def _damaged(self, path: Path, what: str) -> CampaignError:
        return CampaignError(
            f"{path} is damaged ({what[:200]}): remove it, and let '{self.maker}' make it again"
        )


def as_number(value: object) -> float:
    """A value that has to be a finite number.

    Raises:
        TypeError: it is no number.
        ValueError: it is not finite.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r} is no number")
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value!r} is not finite")
    return number


def as_whole(value: object) -> int:
    """A value that has to be a whole number.

    Raises:
        TypeError: it is none.
    """
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{value!r} is no whole number")
    return value
