"""Hostile texts: an unreadable input is refused in one line, and no text steers a terminal."""

from __future__ import annotations

import io
import json
import re
import shutil
import sqlite3
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest

from frenetic.campaign import Campaign, CampaignStore
from frenetic.campaign.database import DATABASE
from frenetic.cli.console import ResultsConsole
from frenetic.spec import Spec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from command_line import Frenetic

pytest_plugins = ["command_line"]

DEEP: Final = 100_000
NESTED: Final = {
    "lists": "[" * DEEP + "]" * DEEP,
    "objects": '{"a":' * DEEP + "1" + "}" * DEEP,
    "parentheses": "(" * 10_000,
}
ENTRIES: Final = {
    "run f.toml": "a = {}",
    "run --roads f.toml": "design_speed = {}",
    "run --criteria f.toml": "lateral_jerk = {}",
    "run --odd f.toml": "roads = {}",
    "bench f.toml": "entrants = {}",
    "calibrate f.toml": "driver = {}",
    "calibrate f.jsonl --driver planner --fit braking": "{}",
    "drive f.json": "{}",
    "drive f.xodr": "{}",
    "run --from-roads roads": "{}",
    "run --as f.json": '{{"driven": {}}}',
    "run --roads rural-80,length={}": "",
    "run --roads {}": "",
    "run --criteria after-iso-11270,lateral_jerk={}": "",
    "run --criteria {}": "",
    "run --driver planner,aggression={}": "",
    "run --driver {}": "",
    "run --driver {}:Driver": "",
    "run --simulator embedded,friction={}": "",
    "run --strategy random,max_length={}": "",
    "run --strategy {}": "",
    "run --objective {}": "",
    "run --with delay={}": "",
    "run --with {}": "",
    "run --odd {}": "",
    "run --from {}": "",
    "run --from-roads {}": "",
    "run --time {}": "",
    "run --seed {}": "",
}
"""A command line -> the content of its file; {} stands for the text."""


@pytest.mark.parametrize(
    "nested",
    [
        "lists",
        pytest.param("objects", marks=pytest.mark.heavy),
        pytest.param("parentheses", marks=pytest.mark.heavy),
    ],
)
@pytest.mark.parametrize("entry", ENTRIES)
def test_deeply_nested_input_is_refused_in_one_line_by_every_reader(
    entry: str, nested: str, frenetic: Frenetic, tmp_path: Path
) -> None:
    text = NESTED[nested]
    words = [word.replace("{}", text) for word in entry.split()]
    for word in (word for word in words if re.fullmatch(r"f\.\w+|roads", word)):
        file = tmp_path / word
        if word == "roads":
            file.mkdir()
            file /= "f.json"
        file.write_text(ENTRIES[entry].format(text), encoding="utf-8")
    answer = frenetic(*words)
    assert answer.refuses(), answer.err[-1000:]
    assert len(answer.err) < 2_100
    assert {path.name for path in tmp_path.iterdir()} <= {*words, "roads"}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign with failures."""
    folder = tmp_path_factory.mktemp("campaign") / "c"
    spec = Spec(strategy="random", driver="planner,aggression=1.5", simulations=6, seed=1)
    Campaign.of(spec, folder=folder, workers=1).run()
    return folder


def change(folder: Path, statement: str, *values: str) -> None:
    connection = sqlite3.connect(folder / DATABASE)
    with connection:
        connection.execute(statement, values)
    connection.close()


COLUMNS: Final = (
    ("fact", "value", "name = 'config'"),
    ("fact", "value", "name = 'search'"),
    *(("test", name, "id = 2") for name in ("notes", "parents", "conditions", "fault", "source")),
)


@pytest.mark.parametrize("nested", NESTED)
@pytest.mark.parametrize(("table", "column", "row"), COLUMNS)
def test_deeply_nested_json_in_a_database_is_reported_as_damage_in_one_line(
    table: str, column: str, row: str, nested: str, campaign: Path, frenetic: Frenetic
) -> None:
    shutil.copytree(campaign, "c")
    change(Path("c"), f"UPDATE {table} SET {column} = ? WHERE {row}", NESTED[nested])
    commands = ("show c", "check c", "report c") if table == "fact" else ("show c 2", "check c")
    for command in commands:
        answer = frenetic(*command.split())
        assert "Traceback" not in answer.err
        if command.startswith("check") and answer.code == 1:
            assert "damaged" in answer.out
        else:
            assert answer.refuses("damaged"), answer.err


def test_a_reason_of_several_lines_stays_on_its_line(campaign: Path, frenetic: Frenetic) -> None:
    shutil.copytree(campaign, "c")
    change(Path("c"), "UPDATE test SET reason = ? WHERE id = 2", "It left\n\nPASS  Car is fine")
    lines = frenetic("show", "c", "2").out.splitlines()
    (line,) = [line for line in lines if "Car is fine" in line]
    assert line.startswith("outcome")


# Terminals

EVIL: Final = "\x1b[2J\x1b]0;owned\x07\r\x9b31m\u202egnp.exe"
"""Clears the screen, names the window, rings, goes back, colours, and turns the direction."""
CONTROL: Final = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")


def texts_within(value: object) -> Iterator[str]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield key
            yield from texts_within(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from texts_within(inner)
    elif isinstance(value, str):
        yield value


def with_evil_texts(value: object) -> object:
    """Return JSON whose free texts end with a text that steers a terminal."""
    if isinstance(value, dict):
        fixed = ("outcome", "objective", "kind", "part")
        return {k: v if k in fixed else with_evil_texts(v) for k, v in value.items()}
    if isinstance(value, list):
        return [with_evil_texts(inner) for inner in value]
    return value + EVIL if isinstance(value, str) else value


@pytest.fixture
def evil_campaign(campaign: Path, tmp_path: Path) -> Path:
    """A campaign whose free texts steer a terminal."""
    folder = tmp_path / "c"
    shutil.copytree(campaign, folder)
    for column in ("reason", "operator", "worker"):
        change(folder, f"UPDATE test SET {column} = {column} || ?", EVIL)
    change(folder, "UPDATE test SET notes = ?", json.dumps({EVIL: EVIL}))
    fault = {"part": "driver", "kind": EVIL, "file": EVIL, "line": 3}
    change(folder, "UPDATE test SET fault = ? WHERE id = 2", json.dumps(fault))
    with CampaignStore.open(folder) as store:
        config = json.loads(json.dumps(dict(store.config), default=dict))
    for name in ("strategy", "driver", "simulator", "versions"):
        config[name] = with_evil_texts(config[name])
    change(folder, "UPDATE fact SET value = ? WHERE name = 'config'", json.dumps(config))
    for name, value in (("ended", EVIL), ("notice", EVIL), ("search", {EVIL: EVIL})):
        change(folder, "INSERT OR REPLACE INTO fact VALUES (?, ?)", name, json.dumps(value))
    with (folder / "campaign.log").open("a", encoding="utf-8") as file:
        line = {"time": "2026-01-01T00:00:00.000+00:00", "level": "error", "event": "log"}
        file.write(json.dumps(line | {"message": EVIL, "traceback": EVIL}) + "\n")
    return folder


@pytest.mark.parametrize(
    "command",
    [
        "show c",
        "show c 2",
        "show c --outcome FAIL",
        "show c --follow",
        "report c",
        "check c",
        "resume c --simulations 8",
        "rerun c 2",
        "minimise c 2 --max-drives 2",
        pytest.param("compare c other", marks=pytest.mark.heavy),
        "export c --format competition",
        pytest.param("export c --format csv", marks=pytest.mark.heavy),
        "drive c 2",
        "--debug show c 2",
    ],
)
def test_a_text_of_a_campaign_never_steers_the_terminal(
    command: str, evil_campaign: Path, campaign: Path, frenetic: Frenetic
) -> None:
    assert evil_campaign.name == "c"
    shutil.copytree(campaign, "other")
    answer = frenetic(*command.split())
    assert "Traceback" not in answer.err
    assert CONTROL.findall(answer.out + answer.err) == []
    if command == "show c 2":
        assert r"\x1b[2J\x1b]0;owned\x07\r\x9b31m\u202egnp.exe" in answer.out


def test_json_holds_a_text_of_a_campaign_unchanged(evil_campaign: Path, frenetic: Frenetic) -> None:
    answer = frenetic("show", evil_campaign.name, "2", "--json")
    assert CONTROL.findall(answer.out) == []
    assert any(EVIL in text for text in texts_within(answer.json))
    assert not any(r"\x1b" in text for text in texts_within(answer.json))


def test_an_error_that_quotes_a_file_never_steers_the_terminal(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    (tmp_path / "f.toml").write_text(f'driver = "{json.dumps(EVIL)[1:-1]}"\n', encoding="utf-8")
    answer = frenetic("run", "f.toml")
    assert answer.refuses("\\x1b[2J")
    assert CONTROL.findall(answer.err) == []


def test_a_console_shows_control_characters_and_keeps_styles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    console = ResultsConsole()
    console.file = io.StringIO()
    console.print(EVIL, style="bold", markup=False, soft_wrap=True)
    shown = "\\x1b[2J\\x1b]0;owned\\x07\\r\\x9b31m\\u202egnp.exe"
    assert console.file.getvalue() == f"\x1b[1m{shown}\x1b[0m\n"
