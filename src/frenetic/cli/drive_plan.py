"""The roads that ``frenetic drive`` drives, of a campaign, a road file or a map, and their spec."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, shell
from frenetic.cli.rerun_options import campaign_spec, file_spec
from frenetic.conditions.condition import without
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.campaign import Test
    from frenetic.oracle.drive import Rules
    from frenetic.road import Road, Verdict
    from frenetic.road.files import RoadFile
    from frenetic.road.opendrive import Stretch

_MAP_SIZE_STEP: Final = 100.0
"""Step by which advised sizes of the map grow, in m (our choice)."""


@dataclass(frozen=True)
class RoadToDrive:
    """A road with what a drive on it is compared with and followed by."""

    name: str
    """Text that names the road on a command line, such as ``road.json`` or ``campaign 12``."""
    road: Road
    """The road, placed on the map if it fits."""
    verdict: Verdict
    """Whether the road is valid, and why not."""
    test: Test | None = None
    """The campaign's test; None for a road file."""
    campaign_config: Mapping[str, Any] | None = None
    """The campaign's configuration; None for a road file."""
    recorded_driver: object = None
    """Record of the driver in a road's file; None without one."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """Conditions of the test without those that the command line sets."""
    notes: tuple[str, ...] = ()
    """Sentences about roads of a map that do not quite meet."""
    file_road: Road | None = None
    """The road where its file has it; None if the map has it there, too."""
    rest_after: Callable[[float], RoadToDrive | None] | None = None
    """Distance along a map's road, in m -> the road after this place; None for other roads."""


@dataclass(frozen=True)
class DrivePlan:
    """Roads to drive, and how they are driven."""

    spec: Spec
    """Spec of driver, simulator, rules and conditions."""
    code_folder: Path
    """Folder in which driver and simulator have to be made."""
    targets: list[RoadToDrive]
    """The roads, in the order in which they are driven."""
    rules: Rules | None = None
    """Rules that a campaign records; None for the rules of the spec."""


def plan_for_campaign(
    options: CommandOptions, folder: Path, test_ids: tuple[int, ...], *, is_dry: bool
) -> DrivePlan:
    """Return the plan to drive tests of a campaign as the campaign drove them.

    Args:
        options: options of the command line, which win.
        folder: the campaign's folder.
        test_ids: IDs of the tests.
        is_dry: whether nothing is driven.

    Raises:
        click.UsageError: no test is named, or an option is for a road file.
        CampaignError: the campaign cannot be read, or holds no such test.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.rerun.rerun import recorded_rules

    if not test_ids:
        raise click.UsageError(
            f"{folder} is a folder: say which tests of the campaign, or name a road file"
        )
    if options.says("map_size"):
        raise click.UsageError("--map-size is for a ROAD file: a campaign has its own map")
    with CampaignStore.open(folder) as store:
        tests = [store.test(test_id) for test_id in dict.fromkeys(test_ids)]
        needs_parts = not is_dry or any(not test.road.is_plain for test in tests)
        spec, code_folder = campaign_spec(store, options, needs_trust=needs_parts)
        config, terms, rules = store.config, store.setting, recorded_rules(store, spec)
    replaced = options.overridden_conditions(spec)
    targets = []
    for test in tests:
        fitted, verdict = test.road.placed(terms.map_size, terms.map_margin, terms.road_class)
        target = RoadToDrive(
            f"{folder} {test.id}",
            fitted or test.road,
            verdict,
            test,
            config,
            conditions=without(test.candidate.conditions, *replaced),
            file_road=test.road,
        )
        targets.append(target)
    return DrivePlan(spec, code_folder, targets, rules)


def plan_for_file(
    options: CommandOptions, path: Path, lane: int | None, test_id: int | None, *, is_dry: bool
) -> DrivePlan:
    """Return the plan to drive the road of a file.

    Args:
        options: options of the command line.
        path: the road file.
        lane: ID of an OpenDRIVE lane; None for the usual lane.
        test_id: number of a test in a file with a list of tests; None for other files.
        is_dry: whether nothing is driven: then the road is judged where it lies in the file.

    Raises:
        RoadError: the file holds no road.
    """
    from frenetic.road import Verdict
    from frenetic.road.files import read_road

    file = read_road(path, lane=lane, test=test_id)
    road = file.road()
    spec, code_folder = file_spec(options, file, needs_trust=not is_dry or not road.is_plain)
    terms = spec.terms
    fitted, verdict = road.placed(terms.map_size, road_class=terms.road_class)
    if is_dry:
        verdict = file.check_validity(terms.map_size, terms.road_class)
    if fitted is None:
        verdict = Verdict(False, f"{verdict.message}; {_advice_to_fit(file, road, spec)}")
    name = str(path) if test_id is None else f"{path} {test_id}"
    recorded_driver = file.entries.get("driver")
    target = RoadToDrive(
        name, fitted or road, verdict, recorded_driver=recorded_driver, file_road=road
    )
    return DrivePlan(spec, code_folder, [target])


def _advice_to_fit(file: RoadFile, road: Road, spec: Spec) -> str:
    """Return what to do with a road that does not fit the map."""
    if file.map_road is not None:
        return f"--road {shell(file.map_road)} drives it where it lies"
    map_size = spec.terms.map_size
    while (fitted := road.fitted(map_size)) is None:
        map_size += _MAP_SIZE_STEP
    verdict = fitted.check_validity(map_size, spec.road_class)
    if not verdict.valid:
        return (
            f"on one of {map_size:g} m it is refused, too: {verdict.message}; export it as"
            " OpenDRIVE and drive that file with --road 1, which drives a road where it lies"
        )
    return f"--map-size {map_size:g} has room for it"


def plan_for_map(
    options: CommandOptions, path: Path, map_roads: str, lane: int | None
) -> DrivePlan:
    """Return the plan to drive roads of an OpenDRIVE map where they lie.

    Args:
        options: options of the command line.
        path: the OpenDRIVE file.
        map_roads: IDs of the roads, as ``--road`` takes them.
        lane: ID of the lane; None for the usual lane.

    Raises:
        RoadError: the file holds no such roads.
    """
    from frenetic.errors import RoadError
    from frenetic.road import Verdict
    from frenetic.road.files import read_stretches
    from frenetic.search.continuations import MIN_REST_TIME
    from frenetic.simulators.conditions import rules_in

    spec, code_folder = options.trusted(options.over(Spec(), roads_are_given=False))
    road_map, stretches = read_stretches(path, map_roads, lane=lane)

    def target_on(stretch: Stretch) -> RoadToDrive:
        def rest_after(distance: float) -> RoadToDrive | None:
            rules = rules_in(spec.conditions, spec.rules)
            highest_limit = float(rules.speed_limits_on(stretch.road)[:, 1].max())  # [km/h]
            if stretch.road.length - distance < MIN_REST_TIME * highest_limit / 3.6:
                return None
            try:
                (rest,) = road_map.stretches(stretch.rest_name(distance), lane=lane)
            except RoadError:
                return None
            return target_on(rest)

        verdict = Verdict(True, "")
        if spec.road_class is not None:
            verdict = spec.road_class.verdict(stretch.road)
        name = f"{path} --road {stretch.name}"
        return RoadToDrive(name, stretch.road, verdict, notes=stretch.notes, rest_after=rest_after)

    for stretch in stretches:
        for note in stretch.notes:
            Log().print(f"Note: {note}", markup=False)
    return DrivePlan(spec, code_folder, [target_on(stretch) for stretch in stretches])
