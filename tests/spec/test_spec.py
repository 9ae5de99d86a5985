"""Specs: round trips, merged sources, driving specs, parts, wrong entries and damage."""

from __future__ import annotations

import json
import math
import shutil
from contextlib import suppress
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import dedent
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from specs import ENTRIES, entries, specs, values

from frenetic.analysis.groups import group_campaigns
from frenetic.campaign import Campaign, CampaignStore, RoadTester
from frenetic.campaign.configuration import driving_spec, fault_of, recorded_spec
from frenetic.conditions.domain import Domain
from frenetic.criteria.criterion import CriteriaSet
from frenetic.drivers import Planner
from frenetic.errors import CampaignError, FreneticError
from frenetic.rerun.rerun import rerun_with
from frenetic.road import MAP_MARGIN, MAP_SIZE
from frenetic.road.classes import RoadClass
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.spec import DRIVEN, DRIVING_ENTRIES, SPEC_FILE, USUAL, Budget, Spec
from frenetic.spec.run_settings import TERMS_ENTRIES
from frenetic.spec.terms import Terms

SOURCE = "c/campaign.sqlite"
MAPS = Path(__file__).parents[1] / "cases" / "maps"
TOWN = {"roads": "urban-50", "conditions": {"gust": {"low": 0, "high": 18}}}


# Round trips


@given(specs)
def test_a_campaigns_file_gives_the_written_spec(spec: Spec) -> None:
    with TemporaryDirectory() as folder:
        spec.write(Path(folder))
        assert Spec.read(Path(folder, SPEC_FILE)) == spec


@cache
def recorded() -> str:
    """The configuration of a campaign, as JSON."""
    spec = Spec(strategy="random", simulations=1, seed=1, odd=TOWN)
    return json.dumps(Campaign.of(spec, workers=1).configuration())


@given(specs)
def test_a_database_gives_the_recorded_spec(spec: Spec) -> None:
    config = json.loads(json.dumps({**json.loads(recorded()), "spec": spec.entries()}))
    assert fault_of(config) == ""
    assert recorded_spec(config, source=SOURCE) == spec
    assert driving_spec(config, source=SOURCE) == spec.driving_spec()


@given(specs)
def test_a_roads_file_gives_the_spec_of_its_drive(spec: Spec) -> None:
    driven = Spec.of({"driver": "stanley", "simulator": "embedded"}, spec.driving_spec())
    document = json.loads(json.dumps({DRIVEN: driven.entries(), "lane_width": 3.5}))
    with TemporaryDirectory() as folder:
        path = Path(folder, "road.json")
        path.write_text(json.dumps(document), encoding="utf-8")
        assert Spec.read_driven(path) == Spec.of(driven, {"lane_width": 3.5})


@given(specs)
def test_a_spec_of_its_own_entries_is_equal(spec: Spec) -> None:
    assert Spec.of(spec.entries()) == Spec.of(spec) == Spec.of({}, spec) == spec


@given(specs)
def test_equal_specs_have_one_hash(spec: Spec) -> None:
    assert len({spec, Spec.of(spec.entries())}) == 1


def test_an_empty_spec_has_the_defaults_of_the_parts() -> None:
    spec = Spec()
    assert spec.user_values == {}
    assert (spec.terms, spec.rules, spec.budget, spec.amounts) == (Terms(), Rules(), None, {})
    assert (spec.terms.map_size, spec.terms.map_margin) == (MAP_SIZE, MAP_MARGIN)
    names = [spec.part(kind).name for kind in ("strategy", "driver", "simulator")]
    assert [*names, spec.named_objective] == ["frenetic", "planner", "embedded", "moobd"]
    assert Spec(criteria="after-iso-11270").named_objective == "criteria"
    assert Spec(criteria="competition").named_objective == "moobd"


def test_values_of_any_form_become_one_form() -> None:
    spec = Spec(
        driver='"planner", aggression=1.20'.replace(", ", ","),
        time="1h30m",
        workers="4",
        seed=np.int64(3),  # type: ignore[arg-type]
        map_size=np.float32(250.0),  # type: ignore[arg-type]
        start_from=["one"],  # type: ignore[arg-type]
        criteria="after-iso-11270,speed_limit=60",
        roads="rural-80,length=800",
        odd=TOWN,
    )
    assert (spec.driver, spec.time, spec.workers) == ("planner,aggression=1.2", 5400.0, 4)
    assert type(spec.seed) is int
    assert type(spec.map_size) is float
    assert spec.start_from == ("one",)
    assert (spec.criteria, spec.speed_limit) == ("after-iso-11270", 60.0)
    assert spec.road_class == RoadClass.of("rural-80", {"length": 800})
    assert Spec(roads=spec.road_class.as_json()) == Spec(roads="rural-80,length=800")
    assert Spec(roads=RoadClass.of("rural-80").as_json()).roads == "rural-80"
    own_class = Spec(roads={"design_speed": 60}).road_class
    assert own_class is not None
    assert (own_class.name, own_class.speed_limit) == ("own", 60.0)
    assert spec.domain == Domain.from_entries("own", TOWN)
    assert Spec(criteria="speed_limit=60") == Spec(speed_limit=60.0)


# Sources


def merged(*sources: dict[str, Any]) -> dict[str, Any]:
    return Spec.of(*sources).entries()


@pytest.mark.parametrize(
    ("earlier", "later", "entries"),
    [
        ({"seed": 1, "map_size": 250.0}, {"seed": 2}, {"seed": 2, "map_size": 250.0}),
        ({"seed": 1}, {}, {"seed": 1}),
        # Parts
        ({"driver": "planner,a=1"}, {"driver": "planner,b=2"}, {"driver": "planner,a=1,b=2"}),
        ({"driver": "planner,a=1"}, {"driver": "b=2"}, {"driver": "planner,a=1,b=2"}),
        ({"driver": "planner,a=1"}, {"driver": "planner,a=2"}, {"driver": "planner,a=2"}),
        ({"driver": "planner,a=1"}, {"driver": "stanley"}, {"driver": "stanley"}),
        ({"driver": "planner,a=1"}, {"driver": "stanley,b=2"}, {"driver": "stanley,b=2"}),
        # Conditions
        (
            {"with": {"delay": 0.1, "view": 30.0}},
            {"with": {"view": 20.0, "noise": 0.2}},
            {"with": {"delay": 0.1, "view": 20.0, "noise": 0.2}},
        ),
        ({"with": {"delay": 0.1, "view": 30.0}}, {"with": {"delay": 0, "view": math.inf}}, {}),
        # A wall limit belongs to a simulator
        (
            {"simulator": "beamng", "wall_limit": 90.0},
            {"simulator": "steps=3"},
            {"simulator": "beamng,steps=3", "wall_limit": 90.0},
        ),
        (
            {"wall_limit": 9.0},
            {"simulator": "embedded"},
            {"simulator": "embedded", "wall_limit": 9},
        ),
        ({"wall_limit": 9.0}, {"simulator": "beamng"}, {"simulator": "beamng"}),
        (
            {"wall_limit": 9.0},
            {"simulator": "beamng", "wall_limit": 5.0},
            {"simulator": "beamng", "wall_limit": 5.0},
        ),
        # A speed limit replaces an earlier amount of speed
        ({"with": {"speed": 40.0}}, {"speed_limit": 60.0}, {"speed_limit": 60.0}),
        (
            {"speed_limit": 60.0},
            {"with": {"speed": 40.0}},
            {"speed_limit": 60.0, "with": {"speed": 40.0}},
        ),
        # Other entries replace all earlier values
        ({"from": ["a", "b"]}, {"from": ["c"]}, {"from": ("c",)}),
        ({"criteria": "after-un-r79"}, {"criteria": "competition"}, {"criteria": "competition"}),
        (
            {"criteria": "after-un-r79"},
            {"speed_limit": 60.0},
            {"criteria": "after-un-r79", "speed_limit": 60.0},
        ),
    ],
)
def test_later_sources_win(
    earlier: dict[str, Any], later: dict[str, Any], entries: dict[str, Any]
) -> None:
    assert merged(earlier, later) == entries


BEFORE_ROADS = {
    "speed_limit": 60.0,
    "map_size": 300.0,
    "map_margin": 5.0,
    "lane_width": 3.0,
    "with": {"speed": 40.0, "delay": 0.1},
}


@pytest.mark.parametrize(
    ("roads", "limit", "map_size", "lane_width"),
    [
        ({"roads": "rural-80"}, 80.0, RoadClass.of("rural-80").map_size, 3.5),
        ({"odd": TOWN}, 50.0, RoadClass.of("urban-50").map_size, 3.25),
        ({"roads": "competition"}, Rules().speed_limit, MAP_SIZE, Terms().lane_width),
    ],
)
def test_roads_set_speed_limit_map_and_lanes(
    roads: dict[str, Any], limit: float, map_size: float, lane_width: float
) -> None:
    spec = Spec.of(BEFORE_ROADS, roads)
    assert spec.rules.speed_limit == limit
    assert (spec.terms.map_size, spec.terms.lane_width) == (map_size, lane_width)
    assert spec.terms.map_margin == 5.0
    assert spec.conditions == {"delay": 0.1}
    earlier_roads = Spec.of({"roads": "motorway-130"}, roads)
    assert earlier_roads.road_class == Spec.of(roads).road_class


def test_a_domain_without_roads_keeps_the_earlier_roads() -> None:
    calm = {"conditions": TOWN["conditions"]}
    spec = Spec.of(BEFORE_ROADS, {"odd": calm})
    assert spec.entries().items() >= BEFORE_ROADS.items()


def test_roads_win_over_a_domains_roads() -> None:
    for spec in (Spec.of({"odd": TOWN}, {"roads": "rural-80"}), Spec(odd=TOWN, roads="rural-80")):
        assert spec.road_class == RoadClass.of("rural-80")
        assert spec.domain is not None


def test_a_value_equal_to_the_default_wins_over_a_class() -> None:
    options = {"roads": "rural-80", "map_size": 200.0, "lane_width": 4.0, "speed_limit": 70.0}
    for spec in (
        Spec.of(options),
        Spec.of({"roads": "rural-80"}, options),
        Spec.of(options, {"seed": 1}),
    ):
        assert spec.entries().items() >= options.items()
        assert (spec.terms.map_size, spec.terms.lane_width) == (200.0, 4.0)
        assert (spec.rules.speed_limit, spec.rules.road_limits) == (70.0, "ignored")
    by_class = Spec.of({"roads": "rural-80"}).rules
    assert (by_class.speed_limit, by_class.road_limits) == (80.0, "kept")
    assert Spec(speed_limit=70.0).rules.road_limits == "ignored"


def test_rules_that_are_not_set_come_from_the_caller() -> None:
    usual = Rules(speed_limit=50.0, stuck_time=5.0)
    assert Spec().rules_over(usual) == usual
    assert Spec(oob_tolerance=0.5).rules_over(usual) == Rules(
        speed_limit=50.0, stuck_time=5.0, oob_tolerance=0.5
    )
    judged = Spec(criteria="after-iso-11270").rules_over(usual)
    assert judged.criteria == CriteriaSet.of("after-iso-11270")


# Driving specs


@given(specs, st.booleans())
def test_driving_spec_and_the_other_entries_make_the_spec(
    spec: Spec, roads_are_given: bool
) -> None:
    driving = spec.driving_spec(roads_are_given=roads_are_given)
    others = spec.without_driving(roads_are_given=roads_are_given)
    names = DRIVING_ENTRIES if roads_are_given else (*DRIVING_ENTRIES, "roads", *TERMS_ENTRIES)
    assert driving.user_values.keys() <= {*names}
    both = {**driving.entries(), **others.entries()}
    without_roads = {name: both[name] for name in both if name != "roads"}
    assert without_roads == {n: v for n, v in spec.entries().items() if n != "roads"}
    assert spec.roads is None or both["roads"] == spec.roads


def test_a_driving_spec_has_the_class_of_the_roads() -> None:
    assert Spec(odd=TOWN).driving_spec().entries() == {"roads": "urban-50"}
    assert Spec(roads="competition").driving_spec().entries() == {"roads": "competition"}
    assert Spec(odd=TOWN).driving_spec(roads_are_given=True) == Spec().driving_spec() == Spec()


def test_conditions_of_a_drive_win_over_those_of_the_spec() -> None:
    spec = Spec(conditions={"delay": 0.1, "fog": 50.0}).in_conditions({"fog": 30.0, "noise": 0.2})
    assert spec.conditions == {"delay": 0.1, "fog": 30.0, "noise": 0.2}
    friction = Spec(simulator="embedded,friction=0.7")
    assert friction.amounts == {"friction": 0.7}
    assert friction.in_conditions({"friction": 0.4}).amounts == {"friction": 0.4}


# Parts


def test_a_spec_makes_the_parts_that_it_names(tmp_path: Path) -> None:
    spec = Spec(
        strategy="random",
        driver="planner,aggression=1.2",
        conditions={"view": 20.0, "noise": 0.1},
        simulator="embedded,friction=0.7",
        criteria="speed_limit=50",
        seed=7,
        max_in_flight=3,
        simulations=5,
        wall_limit=7.0,
    )
    campaign = Campaign.of(spec, folder=tmp_path / "c", workers=2)
    tester = campaign.tester
    assert isinstance(tester.driver, Planner)
    assert tester.described["driver"]["options"]["aggression"] == 1.2  # type: ignore[call-overload,index]
    assert tester.terms.conditions == {"view": 20.0, "noise": 0.1}
    assert (campaign.seed, campaign.budget) == (7, Budget(simulations=5))
    assert tester.simulator.rules.speed_limit == 50.0
    assert campaign.spec == Spec.of(spec, {"workers": 2})
    assert campaign.configuration()["spec"] == Spec.of(spec, {"workers": 2}).entries()
    campaign.run()
    with CampaignStore.open(tmp_path / "c") as store:
        assert recorded_spec(store.config, source=SOURCE) == campaign.spec
        assert dict(store.setting.conditions) == {"view": 20.0, "noise": 0.1}
    assert Spec.read(tmp_path / "c" / SPEC_FILE) == campaign.spec


def test_a_strategy_gets_what_it_asks_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = """
        from frenetic.search import RandomSearch

        class Curious(RandomSearch):
            def __init__(self, *, seed, spec, driver, simulator):
                super().__init__(seed=seed)
                self.known = spec, driver, simulator
        """
    (tmp_path / "curious.py").write_text(dedent(text), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    spec = Spec(strategy="curious.py:Curious", seed=3, simulations=1)
    campaign = Campaign.of(spec, folder=tmp_path / "c", workers=1)
    known_spec, driver, simulator = campaign.strategy.known  # type: ignore[attr-defined]
    assert Spec.of(known_spec) == Spec.of(USUAL, spec)
    assert (driver, simulator) == (campaign.tester.driver, campaign.tester.simulator)
    assert spec.make_strategy().known[1:] == (None, None)  # type: ignore[attr-defined]


def test_a_campaign_of_objects_records_roads_and_conditions_only(tmp_path: Path) -> None:
    domain = Domain.from_entries("town", TOWN)
    terms = Terms.of_class(domain.road_class, domain=domain, conditions={"delay": 0.1})
    campaign = Campaign(
        strategy=RandomSearch(
            seed=1, map_size=terms.map_size, road_class=terms.road_class, domain=domain
        ),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        terms=terms,
        budget=Budget(simulations=1),
        folder=tmp_path / "c",
    )
    assert campaign.spec is None
    campaign.run()
    assert not (tmp_path / "c" / SPEC_FILE).exists()
    with CampaignStore.open(tmp_path / "c") as store:
        spec = recorded_spec(store.config, source=SOURCE)
        assert driving_spec(store.config, source=SOURCE) is None
    assert spec.terms == terms
    assert (spec.driver, spec.simulator, spec.budget) == (None, None, None)


def test_the_class_that_real_roads_show_is_recorded(tmp_path: Path) -> None:
    folder = shutil.copytree(MAPS / "02-from-roads", tmp_path / "roads")
    spec = Spec(from_roads=str(folder), simulations=1, seed=1)
    shown = spec.road_class
    assert shown is not None
    config = Campaign.of(spec, workers=1).configuration()
    shutil.rmtree(folder)
    recorded = recorded_spec(config, source=SOURCE)
    assert recorded.road_class == recorded.driving_spec().road_class == shown
    assert recorded.from_roads == str(folder)


def test_parts_that_cannot_be_made_are_refused() -> None:
    with pytest.raises(FreneticError, match="the option seed of the strategy is not allowed"):
        Spec(strategy="random,seed=5").make_strategy()
    with pytest.raises(FreneticError, match="searches roads alone, not the conditions of own"):
        Spec(strategy="frenetic-2021", odd=TOWN).make_strategy()
    with pytest.raises(ValueError, match="map_size is 15: more than twice the margin of 10 m"):
        Spec(map_size=15.0).terms  # noqa: B018


# Wrong entries


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "unknown": ({"simulation": 5}, "there is no entry 'simulation'; did you mean 'simulations'?"),
    "count": ({"simulations": 0}, "simulations is 0: a whole number >= 1 is needed"),
    "fraction": ({"simulations": 1.5}, "simulations is 1.5: a whole number is needed"),
    "text": ({"speed_limit": "fast"}, "speed_limit is 'fast': a number is needed"),
    "infinite": ({"map_size": math.inf}, "map_size is inf: a number that is finite is needed"),
    "no number": ({"map_margin": math.nan}, "map_margin is nan: a number >= 0 is needed"),
    "true": ({"seed": True}, "seed is True: a whole number is needed"),
    "time": ({"time": "soon"}, "'soon' is not a time: write 90s, 10m or 1h30m"),
    "workers": ({"workers": 5000}, "workers is 5000: at most 1024 are allowed"),
    "scheduler": ({"workers": "here"}, "'here' is neither a number nor the address of a Dask"),
    "part": ({"driver": 3}, "driver is 3: a text is needed"),
    "empty": ({"driver": ""}, "driver is '': a text of length >= 1 is needed"),
    "option": ({"driver": "planner,fast"}, "'fast' is not OPTION=VALUE"),
    "conditions": ({"with": 3}, "with is 3: names with values is needed"),
    "condition": ({"with": {"fogg": 3}}, "unknown condition 'fogg'; did you mean 'fog'?"),
    "amount": ({"with": {"friction": 9}}, "friction is 9: 0.01 to 1.5 is needed"),
    "amount's kind": ({"with": {"fog": "thick"}}, "with is {'fog': 'thick'}: a number is needed"),
    "campaigns": ({"from": ["c", 3]}, "from[1] is 3: a text is needed"),
    "class": ({"roads": "rural-81"}, "there is no road class 'rural-81': choose competition, urb"),
    "values": ({"roads": {}}, "design_speed is missing"),
    "criteria": ({"criteria": "nice"}, "there are no criteria 'nice': choose competition, "),
    "signal": ({"criteria": {"speed": 3}}, "there is no signal speed: choose from edge_dista"),
    "rule": ({"criteria": "speed_limit=inf"}, "speed_limit is inf: a number that is finite is"),
    "share": ({"criteria": "oob_tolerance=2"}, "oob_tolerance is 2: a number <= 1 is needed"),
    "domain": ({"odd": {"fog": 3}}, "there is no entry fog: about, roads and conditions are"),
    "file": ({"odd": "nowhere.toml"}, "there is no file nowhere.toml"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_entry_is_refused_in_one_line_with_what_is_needed(name: str) -> None:
    wrong, text = WRONG[name]
    with pytest.raises((ValueError, FreneticError)) as caught:
        Spec.of({"driver": "stanley"}, wrong)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


anything = st.dictionaries(st.sampled_from([*ENTRIES, "simulation"]), values)


@given(entries, anything)
def test_reading_entries_raises_no_other_errors(
    right: dict[str, Any], wrong: dict[str, Any]
) -> None:
    with suppress(ValueError, FreneticError):
        spec = Spec.of(right, wrong)
        assert Spec.of(spec.entries()) == Spec.of(spec)


# Damage


MISSING = object()
LINE = f"{SOURCE} is damaged: it does not say with what it was driven: "


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("map_size", 1e999, "Expected `float` <= "),
        ("map_margin", -2.0, "Expected `float` >= 0.0 - at `$.map_margin`"),
        ("max_in_flight", 0, "Expected `int` >= 1 - at `$.max_in_flight`"),
        ("workers", 1.5, "Expected `int | str`, got `float` - at `$.workers`"),
        ("conditions", {"delay": "long"}, "got `str` - at `$.conditions[...]`"),
        ("car", MISSING, "missing required field `car`"),
        ("car.length", -1.0, "length is -1.0: a positive number is needed - at `$.car`"),
        ("rules.oob_tolerance", 2.0, "a share above 0 and up to 1 is needed - at `$.rules`"),
        ("driver.class", MISSING, "missing required field `class` - at `$.driver`"),
        ("strategy", [], "Expected `object`, got `array` - at `$.strategy`"),
        ("start_from", [{}], "missing required field `folder` - at `$.start_from[0]`"),
        ("budget", {}, "the budget limits nothing: "),
        ("budget.simulations", -1, "simulations is -1: a whole number of at least 1 is needed"),
        ("versions.numpy", 2, "Expected `str`, got `int` - at `$.versions[...]`"),
        ("spec", 3, "Expected `object | null`, got `int` - at `$.spec`"),
        ("spec.run", {}, "Object contains unknown field `run` - at `$.spec`"),
        ("spec.simulator", "embedded,friction", "'friction' is not OPTION=VALUE"),
        ("spec.with", {"delay": "long"}, "got `str` - at `$.spec.with[...]`"),
        ("spec.with", {"fogg": 1.0}, "unknown condition 'fogg'; did you mean 'fog'?"),
        ("spec.wall_limit", -1.0, "Expected `float` > 0.0 - at `$.spec.wall_limit`"),
        ("spec.roads", "rural-81", "there is no road class 'rural-81'"),
        ("spec.odd", {"fog": 3}, "there is no entry fog"),
    ],
)
def test_damage_is_refused_in_one_line_with_its_path(path: str, value: Any, message: str) -> None:
    config = json.loads(recorded())
    *parents, name = path.split(".")
    inner = config
    for parent in parents:
        inner = inner[parent]
    inner[name] = value
    if value is MISSING:
        del inner[name]
    with pytest.raises(CampaignError) as caught:
        recorded_spec(config, source=SOURCE)
    text = str(caught.value)
    assert text.startswith(LINE)
    assert text.endswith("; restore it from a copy")
    assert message in text
    assert message in fault_of(config)
    assert "\n" not in text
    with pytest.raises(CampaignError, match="is damaged"):
        driving_spec(config, source=SOURCE)


recorded_names = st.deferred(lambda: st.sampled_from([*json.loads(recorded())]))


@given(st.dictionaries(recorded_names, values), anything, st.booleans())
def test_reading_a_database_raises_campaign_errors_only(
    damage: dict[str, Any], wrong: dict[str, Any], is_spec: bool
) -> None:
    config = json.loads(recorded()) | damage
    if is_spec:
        config["spec"] = wrong
    with suppress(CampaignError):
        recorded_spec(config, source=SOURCE)


@pytest.mark.parametrize(
    ("driven", "text"),
    [
        (3, "names with values are needed"),
        ({"driver": "planner"}, "it has no simulator"),
        ({"simulator": "embedded"}, "it has no driver"),
        ({"driver": "planner", "simulator": 3}, "simulator is 3: a text is needed"),
        ({"driver": "planner", "simulator": "embedded", "haze": 1}, "there is no entry 'haze'"),
    ],
)
def test_a_wrong_entry_of_a_roads_file_is_refused_with_a_remedy(driven: object, text: str) -> None:
    with pytest.raises(FreneticError) as caught:
        Spec.of_driven(driven, source="road.json")
    message = str(caught.value)
    assert message.startswith("road.json: its entry 'driven' does not say with what the road was")
    assert text in message
    assert message.endswith("; remove the entry and name a driver")


OTHER_TERMS: dict[str, dict[str, Any]] = {
    "map_size": {"map_size": 250.0},
    "map_margin": {"map_margin": 20.0},
    "lane_width": {"lane_width": 3.5},
    "road_class": {
        "roads": RoadClass.of("urban-50", {"length": 150}).as_json(),
        "map_size": MAP_SIZE,
        "lane_width": 4.0,
    },
    "domain": {"odd": {"name": "x", "conditions": {"delay": {"low": 0.0, "high": 0.1}}}},
    "conditions": {"with": {"delay": 0.1}},
}
"""Field of terms -> entries that give it another value."""


def campaign_in(folder: Path, **entries: Any) -> Campaign:
    """A campaign of one drive."""
    usual = {"strategy": "random", "driver": "planner", "seed": 1, "simulations": 1}
    return Campaign.of(Spec.of(usual, entries), folder=folder, workers=1)


@pytest.fixture(scope="module")
def usual_campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("terms") / "usual"
    campaign_in(folder).run()
    return folder


@pytest.mark.parametrize("field", [item.name for item in fields(Terms)])
def test_other_terms_make_another_campaign(
    field: str, usual_campaign: Path, tmp_path: Path
) -> None:
    """Other terms are not resumed, form another group, and their reruns go to another folder."""
    other = campaign_in(tmp_path / "other", **OTHER_TERMS[field])
    differing = [
        item.name
        for item in fields(Terms)
        if getattr(other.tester.terms, item.name) != getattr(Terms(), item.name)
    ]
    assert differing == [field]
    with pytest.raises(CampaignError, match=field.replace("_", " ")):
        campaign_in(usual_campaign, **OTHER_TERMS[field]).resume()
    other.run()
    assert len(group_campaigns([usual_campaign, other.folder])) == 2
    usual = RoadTester.of(Spec(driver="planner"), Terms())
    folders = [
        rerun_with(usual_campaign, tester, tests=[1]).folder
        for tester in (usual, replace(usual, terms=replace(other.tester.terms, domain=None)))
    ]
    assert (folders[0] == folders[1]) == (field == "domain")


def test_a_later_option_of_the_simulator_wins_over_an_earlier_condition() -> None:
    icy = Spec.of({"with": {"friction": 0.5, "delay": 0.1}})
    dry = Spec.of(icy, {"simulator": "embedded,friction=1.2"})
    assert dry.conditions == {"delay": 0.1}
    assert dry.amounts == {"friction": 1.2, "delay": 0.1}
    assert Spec.of(dry, {"with": {"friction": 0.5}}).terms.conditions["friction"] == 0.5


def test_amounts_may_be_numbers_of_numpy() -> None:
    assert Spec(conditions={"delay": np.float64(0.1)}).conditions == {"delay": 0.1}
    assert type(Spec.of({"with": {"delay": np.float32(1)}}).conditions["delay"]) is float
    assert Terms(conditions={"delay": np.float64(0.1)}).conditions == {"delay": 0.1}


def test_two_values_of_a_rule_are_refused() -> None:
    with pytest.raises(ValueError, match="speed_limit is 60, and 70 in the criteria: leave out"):
        Spec.of({"criteria": "competition,speed_limit=70", "speed_limit": 60})
    assert Spec.of({"criteria": "speed_limit=70", "speed_limit": 70}).speed_limit == 70.0


def test_the_name_of_an_attribute_in_a_file_is_corrected_to_the_entry() -> None:
    with pytest.raises(ValueError, match="there is no entry 'conditions': it is 'with'"):
        Spec.of({"conditions": {"delay": 0.1}})
