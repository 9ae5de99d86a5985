"""Screening: a twin drives many roads, and the simulator of a campaign those that promise most.

`frenetic.twin.screened` says how they are chosen.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from frenetic.campaign.objective import Objective
from frenetic.errors import FreneticError
from frenetic.registry import options_of
from frenetic.search.strategy import Strategy, has_own
from frenetic.spec import Part, Spec, describe
from frenetic.twin.profile import Profile
from frenetic.twin.screened import Screened
from frenetic.twin.twin import Twin
from frenetic.versions import SHORT

_OF_THE_RUN: Final = ("seed", "map_size", "road_class", "domain")
"""Options that the spec gives to the other strategy, too."""


def screened(
    spec: Spec, profile: Path | str, strategy: str = "frenetic", **options: Any
) -> Strategy:
    """The strategy ``screened``: a search in the twin of a profile, laid over another strategy.

    Args:
        spec: of the campaign.
        profile: file of the twin's profile.
        strategy: name of the other strategy.
        options: its own.

    Raises:
        FreneticError: the strategy cannot learn from roads of the twin, the profile cannot be read
            or is for other terms, or a part cannot be made.
    """
    read = Profile.read(profile)
    _check_terms(read, spec, source=profile)
    own = {name: value for name, value in options.items() if name not in _OF_THE_RUN}
    searching = replace(spec, strategy=Part(strategy, own))
    inner = searching.make_strategy()
    if not has_own(inner, "replace"):
        raise FreneticError(
            "screening needs a strategy that takes other roads than it asked for, as frenetic and"
            f" random do: {strategy} has no method 'replace'"
        )
    seed = int(np.random.SeedSequence([spec.seed, 1]).generate_state(1)[0])
    scout = replace(searching, seed=seed).make_strategy()
    of_twin = read.spec()
    twin = Twin.of(replace(of_twin, margin=spec.margin))
    described = describe(inner)
    digest = hashlib.sha256(msgspec.json.encode(read)).hexdigest()[:SHORT]
    return Screened(
        inner,
        scout,
        partial(twin.evaluation, objective=Objective.load(spec.objective)),
        twin=twin,
        name=f"{read.name}, {of_twin.driver.name}, from {profile}",
        options={
            **(options_of(inner) or {}),
            "strategy": f"{strategy} ({described['version']})",
            "profile": f"{profile} (SHA-256 {digest})",
        },
    )


def _check_terms(profile: Profile, spec: Spec, *, source: object) -> None:
    """Refuses a twin of other rules, another map or lane.

    Raises:
        FreneticError: it differs.
    """
    ours, theirs = (
        {
            "speed_limit": one.rules.speed_limit,
            "oob_tolerance": one.rules.oob_tolerance,
            "map_size": one.map_size,
            "lane_width": one.lane_width,
        }
        for one in (spec, profile.spec())
    )
    differing = [
        f"{name.replace('_', ' ')} {theirs[name]:g}, not {ours[name]:g}"
        for name in ours
        if theirs[name] != ours[name]
    ]
    if differing:
        raise FreneticError(
            f"{source} is the profile of a twin for other terms ({'; '.join(differing)}): give the"
            " search the same, or calibrate a twin for them"
        )
