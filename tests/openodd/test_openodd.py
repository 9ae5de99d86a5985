"""Domains as OpenODD: read, written, judged alike, and what was driven in them."""

from __future__ import annotations

import csv
import math
import random
import sys
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import openodd
import pytest

from frenetic import CampaignStore
from frenetic.domain import Domain
from frenetic.errors import FreneticError
from frenetic.openodd import domain_document
from frenetic.outcome import Outcome
from frenetic.quantities import quantities, quantity

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

TOWN = """
about = 'Town "roads"\\n🌧 in all weather'
roads = "urban-50,length=400"

[conditions]
friction = { low = 0.1, high = 1.0, mean = 0.85, deviation = 0.2 }
gust = { low = -18, high = 18, mean = 0, deviation = 6 }
delay = { low = 0.05, high = 0.35, chance = 0.2 }
view = { low = 20, high = 60, chance = 0.5 }
noise = { low = 1e-5, high = 0.2 }
load = 150
lag = { low = 0.1, high = 0.10000000000000002 }
"""
PLAIN = "[conditions]\nspeed = { low = 30.1, high = 33.3 }\nlag = 0.1"


def domain_of(folder: Path, text: str, suffix: str) -> Domain:
    path = folder / f"town{suffix}"
    path.write_text(text, encoding="utf-8")
    return Domain.of(path)


@pytest.mark.parametrize("text", [TOWN, PLAIN, 'roads = "rural-80"'])
def test_a_domain_is_read_back_as_it_was(text: str, tmp_path: Path) -> None:
    domain = domain_of(tmp_path, text, ".toml")
    again = domain_of(tmp_path, domain_document(domain), ".yaml")
    assert again == domain
    assert again.conditions == domain.conditions


def test_each_quantity_can_be_written(tmp_path: Path) -> None:
    rows = [row for row in quantities().values() if not row.place_of]
    text = "[conditions]\n"
    text += "\n".join(f"{row.name} = {{ low = {row.low}, high = {row.high} }}" for row in rows)
    domain = domain_of(tmp_path, text, ".toml")
    assert domain_of(tmp_path, domain_document(domain), ".yml") == domain


def test_ranges_of_an_edited_file_win_over_what_was_written(tmp_path: Path) -> None:
    domain = domain_of(tmp_path, TOWN, ".toml")
    text = domain_document(domain).replace("[0.1 .. 1.0]", "[0.2 .. 0.9]")
    text = text.replace('["urban-50"]', '["rural-80"]')
    again = domain_of(tmp_path, text, ".yaml")
    friction = again.conditions["friction"]
    assert (friction.low, friction.high, friction.mean, friction.deviation) == (0.2, 0.9, 0.85, 0.2)
    assert again.road_class is not None
    assert (again.road_class.name, again.road_class.length) != ("urban-50", 400.0)


def values_of(odd: Any, conditions: Mapping[str, float]) -> dict[str, Any]:
    """Values of an ODD's attributes in some conditions; None where a usual one is no number."""
    values: dict[str, Any] = {}
    for attribute in odd.attributes:
        leaf = attribute.name.rpartition(".")[2]
        if leaf in quantities():
            amount = conditions.get(leaf, quantity(leaf).nothing)
            values[attribute.name] = None if amount in (None, math.inf) else amount
    return values


def amounts(rng: random.Random, domain: Domain, name: str) -> list[float]:
    """Amounts inside, outside and at the edges of a quantity's range, and the usual one."""
    of, row = domain.conditions[name], quantity(name)
    edges = [of.low, of.high]
    beside = [math.nextafter(edge, to) for edge in edges for to in (-math.inf, math.inf)]
    usual = [] if row.nothing is None or math.isinf(row.nothing) else [row.nothing]
    spread = of.high - of.low + 0.1
    return [*edges, *beside, *usual, rng.uniform(of.low - spread, of.high + spread)]


def test_both_judge_alike(tmp_path: Path) -> None:
    domain = domain_of(tmp_path, TOWN, ".toml")
    (tmp_path / "odd.yaml").write_text(domain_document(domain), encoding="utf-8")
    odd = openodd.load_odd_file(tmp_path / "odd.yaml")  # as any tool does, without us
    rng, inside = random.Random(1), 0
    for number in range(2000):
        conditions: dict[str, float] = {}
        strange = rng.choice(list(domain.conditions)) if number % 2 else ""
        for name, of in domain.conditions.items():
            if name == strange:
                conditions[name] = rng.choice(amounts(rng, domain, name))
            elif rng.random() < 0.7 or (name == "load" and number % 4):
                conditions[name] = rng.choice([of.low, of.high, rng.uniform(of.low, of.high)])
        verdict = domain.holds(conditions)
        assert odd.evaluate(values_of(odd, conditions)).inside == verdict, conditions
        inside += verdict
    assert 500 < inside < 1500


# Files of others

TAXONOMY = """
TAXONOMY:
  scenery: {road_class: [urban-50, rural-80], speed: float velocity, friction: float, zone: [a, b]}
  environment:
    wind: {gust: float velocity}
    rate: float precipitation_rate
    strong_wind:
      "no": {gust: "[-8 .. 8] m/s"}
      "yes": {gust: "> 8 m/s"}
  ego: {load: float mass, delay: float time}
"""


@pytest.mark.parametrize(
    ("rules", "ranges"),
    [
        (
            "ODD: {m: {INCLUDE_AND: {speed: '[36 .. 72] km/h', friction: '>= 0.3'}}}",
            {"speed": (36.0, 72.0), "friction": (0.3, 1.5)},
        ),
        ("ODD: {m: {INCLUDE_AND: {delay: '<= 200 ms', load: 100 kg}}}", None),
        (
            "ODD: {m: {EXCLUDE_OR: {friction: '< 0.4', gust: '> 10 m/s'}}}",
            {"friction": (0.4, 1.5), "gust": (-40.0, 10.0)},
        ),
        (
            "ODD: {m: {INCLUDE_AND: {friction: '>= 0.3'}, EXCLUDE_OR: {gust: '> 10 m/s'}}}",
            {"friction": (0.3, 1.5), "gust": (-40.0, 10.0)},
        ),
        (
            "ODD: {m: {INCLUDE_AND: {friction: '< 0.5'}}}",
            {"friction": (0.01, math.nextafter(0.5, 0.0))},
        ),
        (
            "ODD: {m: {EXCLUDE_OR: {AND: {bad: true}}}}\n"
            "MODULES: {p: {LABEL: bad, INCLUDE_OR: {friction: '< 0.3', load: '> 100 kg'}},"
            " q: {LABEL: bad, INCLUDE_AND: {gust: '> 5 m/s'}},"
            " idle: {EXCLUDE_OR: {delay: '> 1 s'}},"
            " off: {LABEL: bad, ACTIVE: false, INCLUDE_AND: {gust: '> 1 m/s', delay: '> 0 s'}}}",
            {"friction": (0.3, 1.5), "load": (0.0, 100.0), "gust": (-40.0, 5.0)},
        ),
    ],
)
def test_ranges_of_other_rules(rules: str, ranges: Any, tmp_path: Path) -> None:
    found = domain_of(tmp_path, TAXONOMY + rules, ".yaml").conditions
    if ranges is not None:
        assert {name: (of.low, of.high) for name, of in found.items()} == ranges
    assert all(of.chance == 1.0 and of.mean is None for of in found.values())


def test_what_it_cannot_lay_is_said(tmp_path: Path) -> None:
    rules = "ODD: {m: {TITLE: Rain, INCLUDE_AND: {rate: '< 3 mm/h', zone: a, friction: '> 0.3',"
    rules += " strong_wind: 'no'}}}"
    domain = domain_of(tmp_path, TAXONOMY + rules, ".yaml")
    assert domain.road_class is None
    assert domain.about == "Rain"
    assert domain.left_out == (
        "zone, rate, strong_wind (no quantity), road_class, speed, gust, load, delay (no limits)"
    )
    assert domain.in_words().endswith(f"left out: {domain.left_out}")
    assert Domain.made("x", domain.entries()) == domain
    assert domain_of(tmp_path, domain_document(domain), ".yaml") == domain


def section(rng: random.Random, others: list[str], operators: tuple[str, str], deep: bool) -> str:
    """A random section of a module, or one nested in it."""
    parts = []
    for name in rng.sample(("friction", "wet", *others), rng.choice((1, 1, 1, 2))):
        low, high = sorted(rng.sample((0.1, 0.2, 0.3, 0.4), 2))
        ranges = (f"'[{low} .. {high}]'", f"'> {low}'", f"'<= {high}'")
        parts.append(f"{name}: {rng.choice(('true', 'false') if name in others else ranges)}")
    if deep and rng.random() < 0.2:
        parts.append(f"{operators[1]}: {section(rng, others, operators, deep=False)}")
    return f"{{{', '.join(parts)}}}"


def rules(rng: random.Random) -> str:
    """Random modules, of which each may need those before it, by name or label."""
    modules: list[str] = []
    for number in range(rng.randint(1, 4)):
        others = [f"m{earlier}" for earlier in range(number)] + ["label"] * (number > 1)
        entries = ["LABEL: label"] if number < 2 else []
        entries += ["ACTIVE: false"] if rng.random() < 0.1 else []
        for kind in rng.sample(("INCLUDE", "EXCLUDE"), rng.choice((1, 1, 2))):
            operators = rng.choice((("AND", "OR"), ("OR", "AND")))
            entries.append(f"{kind}_{operators[0]}: {section(rng, others, operators, deep=True)}")
        modules.append(f"m{number}: {{{', '.join(entries)}}}")
    return f"TAXONOMY: {{friction: float, wet: float}}\nMODULES: {{{', '.join(modules)}}}"


def test_random_rules_are_read_as_they_are_judged_or_refused(tmp_path: Path) -> None:
    """What is read is a box: it judges a grid of amounts as the rules do."""
    rng, refused = random.Random(7), list[str]()
    grid = [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45]
    for _ in range(600):
        text = rules(rng)
        try:
            domain = domain_of(tmp_path, text, ".yaml")
        except FreneticError as error:
            refused.append(str(error))
            continue
        odd = openodd.load_openodd(text)
        for amounts in product(grid, grid):
            conditions = dict(zip(("friction", "wet"), amounts, strict=True))
            assert odd.evaluate(conditions).inside == domain.holds(conditions), text
    said = [sum(word in one for one in refused) for word in ("depend on", "one range", "no quan")]
    assert sum(said) == len(refused)
    assert min(said) > 10
    assert len(refused) < 450


HEAD = TAXONOMY + "ODD: {m: {INCLUDE_AND: "


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "limits no quantity and names no road_class"),
        ("TAXONOMY: {a: [}", "not YAML"),
        ("[" * 100_000, "nested more than 100 levels deep"),
        ("IMPORT: gone.yaml", "cannot read"),
        (HEAD + "{gust: '[1 .. 2] kg'}}}", "'kg' measures mass, not velocity"),
        (HEAD + "{friction: '[0.3 .. 9]'}}}", "friction is from 0.3 to 9: 0.01 to 1.5 is needed"),
        (HEAD + "{road_class: [urban-50, rural-80]}}}", "road_class has 2 classes inside"),
        (HEAD + "{OR: {friction: '> 0.3', gust: '< 3 m/s'}}}}", "friction and gust depend on each"),
        (HEAD + "{friction: '> 0.3'}, EXCLUDE_OR: {friction: '[0.4 .. 0.5]'}}}", "one range"),
        (HEAD + "{friction: '> 0.3'}, EXCLUDE_OR: {friction: '> 0.2'}}}", "inside at nowhere"),
        ("TAXONOMY: {a: {gust: float}, b: {gust: float}}", "2 attributes named gust"),
        (HEAD + "{friction: 1}, METADATA: {frenetic: {conditions: 3}}}}", "in METADATA: Expected"),
        (
            HEAD + "{friction: 1}, METADATA: {frenetic: {conditions: {friction: {mean: 2}}}}}}",
            "mean and deviation are needed together",
        ),
    ],
)
def test_a_wrong_file_is_one_line(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(FreneticError) as caught:
        domain_of(tmp_path, text, ".yaml")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


# Campaigns


def test_a_campaign_goes_on_in_openodds_tools(frenetic: Frenetic, tmp_path: Path) -> None:
    domain = domain_of(tmp_path, TOWN, ".toml")
    (tmp_path / "town.yaml").write_text(domain_document(domain), encoding="utf-8")
    words = ("--odd", str(tmp_path / "town.yaml"), "--simulations", "30", "--seed", "1")
    assert frenetic("run", *words, "--out", "c").code == 0
    done = frenetic("export", "c", "--format", "openodd", "--json")
    assert done.json["format"] == "openodd"
    folder = Path(done.json["folder"])
    assert Domain.of(folder / "odd.yaml") == domain
    with CampaignStore.open("c") as store:
        tests = [test for test in store.tests() if test.outcome in (Outcome.PASS, Outcome.FAIL)]
    merged = openodd.load_and_merge([folder / "runs"])
    assert merged.runs == len(tests)
    odd = openodd.load_odd_file(folder / "odd.yaml")
    with (folder / "campaign_cod.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(int(row["test"]), row["outcome"]) for row in rows] == [
        (test.id, str(test.outcome)) for test in tests
    ]
    for row, test in zip(rows, tests, strict=True):
        assert float(row["scenery.drivable_area.surface.friction"]) == pytest.approx(
            test.candidate.conditions["friction"]
        )
        cells = {name.partition(";")[0]: cell for name, cell in row.items()}
        values = {one.name: cells[one.name] for one in odd.attributes}
        numbers = {n: v if n.endswith("class") else float(v or "nan") for n, v in values.items()}
        assert odd.evaluate(numbers).inside
    failed = frenetic("export", "c", "--format", "openodd", "--outcome", "FAIL", "--out", "f")
    assert failed.code == 0
    assert len(list(Path("f/runs").iterdir())) == sum(t.outcome is Outcome.FAIL for t in tests)


def test_the_extra_is_named(
    frenetic: Frenetic, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "town.yaml").write_text("TAXONOMY: {friction: float}", encoding="utf-8")
    monkeypatch.setitem(sys.modules, "openodd", None)
    done = frenetic("estimate", "--odd", str(tmp_path / "town.yaml"))
    assert done.refuses('pip install ".[odd]"'), done.err
