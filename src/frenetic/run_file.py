"""A run as a TOML file: what the options of `frenetic run` say, by the same names and grammar.

Every campaign with named parts keeps one beside its database, `NAME`. It is a copy for people: the
database is the record, and an edited copy is another run.
"""

from __future__ import annotations

import tomllib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import tomli_w
from msgspec import Struct, ValidationError, convert, field

from frenetic._support.bounds import Count, Finite, Index, NotNegative, Positive, Share
from frenetic._support.files import write_file
from frenetic._support.words import parse_duration, part_word, read_part
from frenetic.errors import FreneticError
from frenetic.spec import MAX_BYTES, Budget, EarlierCampaign, Part, Spec

NAME: Final = "campaign.toml"
"""Name of the file in a campaign's folder."""
_PARTS: Final = ("strategy", "driver", "simulator")


class RunFile(Struct, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """The entries of a file; those that are left out are as for the command line."""

    strategy: str | None = None
    """A part with its options, such as ``"planner,aggression=1.2"``, as on the command line."""
    driver: str | None = None
    simulator: str | None = None
    conditions: dict[str, Finite] = field(name="with", default_factory=dict)
    speed_limit: Positive | None = None
    oob_tolerance: Share | None = None
    wall_limit: Positive | None = None
    """s of wall time that a drive may take; a worker is replaced after 1.5 times that and 10 s."""
    map_size: Positive | None = None
    margin: NotNegative | None = None
    lane_width: Positive | None = None
    simulations: Count | None = None
    time: Positive | str | None = None
    """s, or a text such as ``"8h"``."""
    failures: Count | None = None
    objective: str | None = None
    start_from: list[str] = field(name="from", default_factory=list)
    seed: Index | None = None
    lookahead: Index | None = None
    """Roads that are proposed ahead in an ordered campaign; 0 for an unordered one."""
    workers: Count | str | None = None
    """Roads driven at once, or the address of a Dask scheduler."""


def read_run_file(path: Path | str) -> tuple[Spec, RunFile]:
    """The spec of a file, with the defaults of the command line, and its entries.

    The spec has a budget, seed and lookahead only as far as the file says them.

    Raises:
        FreneticError: there is no such file, or it is wrong; the message names the place in it.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise FreneticError(f"{path} is too large: it has more than {MAX_BYTES} bytes")
        entries = convert(tomllib.loads(data.decode("utf-8")), RunFile)
        time = parse_duration(entries.time) if entries.time is not None else None
        limits: dict[str, Any] = {
            "simulations": entries.simulations,
            "time": time,
            "failures": entries.failures,
        }
        given: dict[str, Any] = {
            "layers": entries.conditions,
            "speed_limit": entries.speed_limit,
            "oob_tolerance": entries.oob_tolerance,
            "wall_limit": entries.wall_limit,
        }
        for kind in _PARTS:
            if (text := getattr(entries, kind)) is not None:
                name, options = read_part(text)
                given |= {kind: name, f"{kind}_options": options}
        others: dict[str, Any] = {
            name: value
            for name in ("map_size", "margin", "lane_width", "seed", "objective")
            if (value := getattr(entries, name)) is not None
        }
        if any(limits.values()):
            others["budget"] = Budget(**limits)
        others["start_from"] = tuple(EarlierCampaign(folder) for folder in entries.start_from)
        others["lookahead"] = entries.lookahead or None
        spec = replace(Spec(strategy=Part("frenetic")).replaced(given), **others)
    except FileNotFoundError:
        raise FreneticError(f"there is no file {path}") from None
    except OSError as error:
        raise FreneticError(f"{path} cannot be read: {error.strerror or error}") from None
    except (ValidationError, ValueError, RecursionError) as error:
        raise FreneticError(f"{path} does not say a run: {error}") from None
    except FreneticError as error:
        raise FreneticError(f"{path}: {error}") from None
    return spec, entries


def write_run_file(spec: Spec, folder: Path) -> None:
    """Writes the file of a campaign into its folder, if its parts have names.

    Raises:
        FreneticError: it cannot be written.
    """
    parts = {kind: getattr(spec, kind) for kind in _PARTS}
    is_whole = all(part.name is not None for part in parts.values())
    if not is_whole or spec.budget is None or not isinstance(spec.seed, int | None):
        return
    entries: dict[str, Any] = {
        **{kind: part_word(part.name, part.options) for kind, part in parts.items()},
        "with": dict(spec.layers),
        "speed_limit": spec.rules.speed_limit,
        "oob_tolerance": spec.rules.oob_tolerance,
        "wall_limit": spec.wall_limit,
        "map_size": spec.map_size,
        "margin": spec.margin,
        "lane_width": spec.lane_width,
        **asdict(spec.budget),
        "objective": spec.objective,
        "from": [earlier.folder for earlier in spec.start_from],
        "seed": spec.seed,
        "lookahead": spec.lookahead or 0,
        "workers": spec.cluster or spec.workers,
    }
    kept = {name: value for name, value in entries.items() if value not in (None, {}, [])}
    text = tomli_w.dumps(kept)
    text = f"# What ran in this folder; 'frenetic run {NAME}' does it again in another.\n{text}"
    write_file(folder / NAME, text, remedy="make room, or let it be written")
