"""What older versions have left on disk opens, resumes, reports and checks.

The fixtures and what is expected of them were made by the version after which their folder is
called, see `make_fixtures.py`.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from frenetic.analysis import read_reruns
from frenetic.bench import Bench
from frenetic.campaign import CampaignStore
from frenetic.outcome import Outcome
from frenetic.redrive.confirm import read_confirmations
from frenetic.search import Frenetic2021
from frenetic.spec import Spec

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

OLD = Path(__file__).parent / "0.1.0"
EXPECTED = json.loads((OLD / "expected.json").read_text(encoding="utf-8"))
SCHEMAS = ("schema-1", "schema-2")


def copy(name: str, tmp_path: Path) -> Path:
    return Path(shutil.copytree(OLD / name, tmp_path / name))


def near(value: Any) -> Any:
    """Equal to the same, with floats to 1e-6."""
    if isinstance(value, dict):
        return {name: near(one) for name, one in value.items()}
    if isinstance(value, list):
        return [near(one) for one in value]
    return pytest.approx(value, rel=1e-6, abs=1e-6) if isinstance(value, float) else value


def plain(value: Any) -> Any:
    """As JSON has it."""
    return json.loads(json.dumps(value))


def rows_of(folder: Path) -> list[list[Any]]:
    with closing(sqlite3.connect(folder / "campaign.sqlite")) as database:
        rows = database.execute(
            "SELECT id, operator, parents, generation, outcome, moobd"
            " FROM test JOIN candidate ON id = candidate_id ORDER BY told"
        ).fetchall()
    return [list(row) for row in rows]


def counts(folder: Path) -> tuple[int, int]:
    """How many tests, and how many were driven."""
    outcomes = [Outcome(row[4]) for row in rows_of(folder)]
    return len(outcomes), sum(one.is_simulated for one in outcomes)


@pytest.mark.parametrize("name", ["commanded", "from-python", *SCHEMAS])
def test_it_is_shown_as_it_was(frenetic: Frenetic, tmp_path: Path, name: str) -> None:
    copy(name, tmp_path)
    known = EXPECTED["from-python" if name in SCHEMAS else name]
    assert frenetic("show", name).code == 0
    whole = frenetic("show", name, "--json").json
    # A newer version says more, and counts dropped candidates beside the tests.
    before = known["show"] | {"folder": name, "tests": known["show"]["tests"] - whole["dropped"]}
    assert {key: whole[key] for key in before} == near(before)
    for one in known["one"]:
        shown = frenetic("show", name, str(one["id"]), "--json").json
        assert shown.pop("picture") == f"{name}/failures/test-{one['id']:05}.png"
        assert {key: shown[key] for key in one if key != "picture"} == near(
            {key: value for key, value in one.items() if key != "picture"}
        )


@pytest.mark.parametrize("name", ["commanded", "from-python", *SCHEMAS])
def test_its_tests_are_read_as_they_were(tmp_path: Path, name: str) -> None:
    known = EXPECTED["from-python" if name in SCHEMAS else name]["tests"]
    with CampaignStore.open(copy(name, tmp_path)) as store:
        records = list(store.tests())
        assert [
            [
                record.candidate.id,
                record.candidate.origin.operator,
                json.dumps(record.candidate.origin.parents),
                record.candidate.origin.generation,
                record.outcome,
                record.moobd,
            ]
            for record in records
        ] == near(known)
        for record in records:
            trajectory = store.test(record.candidate.id).trajectory
            assert (trajectory is not None) == record.outcome.is_driven


@pytest.mark.parametrize("name", ["commanded", "from-python", "interrupted", *SCHEMAS])
def test_nothing_is_wrong_with_it(frenetic: Frenetic, tmp_path: Path, name: str) -> None:
    copy(name, tmp_path)
    answer = frenetic("check", name, "--json")
    assert answer.code == 0
    assert answer.json["is_sound"]
    assert answer.json["findings"] == []


@pytest.mark.parametrize("name", ["commanded", "from-python", "interrupted", *SCHEMAS])
def test_it_has_a_report(frenetic: Frenetic, tmp_path: Path, name: str) -> None:
    folder = copy(name, tmp_path)
    assert frenetic("report", name).code == 0
    assert (folder / "report.html").stat().st_size > 100_000


@pytest.mark.parametrize("name", ["commanded", *SCHEMAS])
def test_its_tests_are_exported(frenetic: Frenetic, tmp_path: Path, name: str) -> None:
    folder = copy(name, tmp_path)
    for kind in ("csv", "competition"):
        assert frenetic("export", name, "--format", kind, "--out", f"{name}/{kind}").code == 0
    exported = list((folder / "competition").glob("test.*.json"))
    assert len(exported) == sum(row[4] != Outcome.DROPPED for row in rows_of(folder))


def test_reruns_of_its_side_file_are_read_as_they_were(tmp_path: Path) -> None:
    assert [
        {
            "test": one.test_id,
            "seed": one.seed,
            "variations": [[v.quantity, v.low, v.high] for v in one.variations],
            "failed": one.failed,
            "judged": one.judged,
            "alike": one.alike,
            "interval": list(one.interval),
            "stability": one.stability,
            "driver": plain(one.driver),
            "simulator": plain(one.simulator),
            "drives": [[drive.outcome, drive.moobd] for drive in one.drives],
        }
        for one in read_reruns(copy("commanded", tmp_path))
    ] == near(EXPECTED["commanded"]["reruns"])


def test_confirmations_of_its_side_file_are_read_as_they_were(tmp_path: Path) -> None:
    found = read_confirmations(copy("commanded", tmp_path))
    known = EXPECTED["commanded"]["confirmations"]
    assert len(found) == len(known) == 1
    (one,), (as_it_was,) = found, known
    assert one.key == as_it_was["key"]
    assert plain(one.driver) == as_it_was["driver"]
    assert plain(one.simulator) == as_it_was["simulator"]
    assert (one.missing, one.alike) == (as_it_was["missing"], as_it_was["alike"])
    for test, [test_id, agreement, is_alike, reason, moobd, records] in zip(
        one.tests, as_it_was["tests"], strict=True
    ):
        assert (test.test_id, test.agreement, test.is_alike) == (test_id, agreement, is_alike)
        assert test.reason == reason
        assert test.other.moobd == near(moobd)
        drive = one.drive(test)
        assert drive is not None
        assert len(drive.trajectory.time) == records


def test_its_side_files_are_in_its_report(frenetic: Frenetic, tmp_path: Path) -> None:
    folder = copy("commanded", tmp_path)
    assert frenetic("report", "commanded").code == 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "In other simulators" in page
    assert "friction 0.9: 3 confirmed." in page
    assert '"kind":"confirmed"' in page  # both paths on each road
    assert "friction 0.8 to 1" in page  # of a rerun
    assert "minimised/test-00025.json" in page


def test_kept_reruns_and_confirmations_stay_when_others_come(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    folder = copy("commanded", tmp_path)
    before = [(one.test_id, one.what_varied, one.drives) for one in read_reruns(folder)]
    (confirmed,) = read_confirmations(folder)
    arguments = ("commanded", "14", "--json")
    assert frenetic("rerun", *arguments, "--times", "2").code == 0
    assert frenetic("confirm", *arguments, "--simulator-option", "friction=0.8").code == 0
    after = [(one.test_id, one.what_varied, one.drives) for one in read_reruns(folder)]
    assert len(after) == len(before) + 1
    assert [one for one in after if one[0] != 14] == before
    keys = [one.key for one in read_confirmations(folder)]
    assert len(keys) == 2
    assert confirmed.key in keys
    assert frenetic("check", "commanded").code == 0


def test_a_rerun_of_the_same_kind_replaces_the_kept_one(frenetic: Frenetic, tmp_path: Path) -> None:
    folder = copy("commanded", tmp_path)
    before = read_reruns(folder)
    again = frenetic(
        *("rerun", "commanded", "25", "--times", "3", "--json"),
        *("--vary", "friction=0.8:1.0", "noise=0.2"),
    )
    assert again.code == 0
    after = read_reruns(folder)
    assert sorted((one.test_id, one.what_varied) for one in after) == sorted(
        (one.test_id, one.what_varied) for one in before
    )
    (kept,) = [one for one in before if one.test_id == 25 and one.variations]
    (anew,) = [one for one in after if one.test_id == 25 and one.variations]
    for old, new in zip(kept.drives, anew.drives, strict=True):
        assert new.outcome is old.outcome
        assert new.moobd == near(old.moobd)


def test_its_minimised_road_is_driven_again(frenetic: Frenetic, tmp_path: Path) -> None:
    copy("commanded", tmp_path)
    answer = frenetic(
        *("drive", "commanded/minimised/test-00025.json", "--json"),
        *("--driver-option", "aggression=1.1", "--noise", "0.05", "--delay", "0.05"),
        *("--simulator-option", "friction=0.95"),
    )
    assert answer.json["outcome"] == "FAIL"
    kept = json.loads((OLD / "commanded/minimised/test-00025.json").read_text(encoding="utf-8"))
    assert answer.json["moobd"] == near(kept["moobd"])
    assert answer.json["reason"] == kept["description"]


def test_a_killed_one_ends_as_its_twin_that_was_not(frenetic: Frenetic, tmp_path: Path) -> None:
    folder = copy("interrupted", tmp_path)
    before = rows_of(folder)
    twin = json.loads((OLD / "twin.json").read_text(encoding="utf-8"))
    assert 20 < len(before) < len(twin)
    assert frenetic("resume", "interrupted", "--workers", "1").code == 0
    assert rows_of(folder) == near(twin)
    assert frenetic("check", "interrupted").code == 0


@pytest.mark.parametrize("workers", ["1", "2"])
def test_it_goes_on_with_a_larger_budget(frenetic: Frenetic, tmp_path: Path, workers: str) -> None:
    folder = copy("commanded", tmp_path)
    tests = rows_of(folder)
    driven = counts(folder)[1]
    going_on = ("--simulations", "5", "--workers", workers)
    assert frenetic("resume", "commanded", *going_on).code == 0
    assert rows_of(folder)[: len(tests)] == tests
    assert counts(folder)[1] == driven + 5
    with CampaignStore.open(folder) as store:
        # What its command line said is still so.
        driver: Any = store.config["driver"]
        assert driver["driver"]["driver"]["options"]["aggression"] == 1.1
    assert frenetic("check", "commanded").code == 0
    assert len(read_reruns(folder)) == len(EXPECTED["commanded"]["reruns"])


@pytest.mark.parametrize("name", SCHEMAS)
def test_an_old_database_is_brought_up_to_date_when_it_is_written(
    tmp_path: Path, name: str
) -> None:
    folder = copy(name, tmp_path)
    tests = rows_of(folder)
    with CampaignStore.open(folder, readonly=False):
        pass
    assert rows_of(folder) == tests
    with (
        closing(sqlite3.connect(folder / "campaign.sqlite")) as upgraded,
        closing(sqlite3.connect(OLD / "from-python" / "campaign.sqlite")) as newer,
    ):
        (version,) = upgraded.execute("PRAGMA user_version").fetchone()
        (least,) = newer.execute("PRAGMA user_version").fetchone()
    assert version >= least


def test_its_failures_are_driven_again_by_a_new_version(frenetic: Frenetic, tmp_path: Path) -> None:
    copy("commanded", tmp_path)
    answer = frenetic("replay", "commanded", "--json")
    assert answer.code == 1  # they still fail
    known = {row[0]: near(row[5]) for row in EXPECTED["commanded"]["tests"] if row[4] == "FAIL"}
    assert (answer.json["same"], answer.json["missing"]) == (len(known), 0)
    assert {one["test_id"]: one["moobd_after"] for one in answer.json["tests"]} == known


def test_two_are_compared(frenetic: Frenetic, tmp_path: Path) -> None:
    copy("commanded", tmp_path)
    copy("schema-1", tmp_path)
    assert frenetic("compare", "commanded", "schema-1").code == 0


def test_a_bench_is_completed_as_it_would_have_been(frenetic: Frenetic, tmp_path: Path) -> None:
    folder = copy("bench", tmp_path)
    known = json.loads((OLD / "bench-runs.json").read_text(encoding="utf-8"))
    listed = frenetic("bench", "--out", "bench", "--list", "--json").json
    assert [(one["folder"], one["ending"] is None) for one in listed] == [
        ("bench/random/01", False),
        ("bench/evolved/01", False),
        ("bench/random/02", True),
        ("bench/evolved/02", True),
    ]
    assert frenetic("bench", "--resume", "--out", "bench", "--workers", "1").code == 0
    listed = frenetic("bench", "--out", "bench", "--list", "--json").json
    for one, as_it_was in zip(listed, known, strict=True):
        assert rows_of(tmp_path / one["folder"]) == near(as_it_was.pop("tests"))
        assert one == as_it_was
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert "evolved" in page
    assert (folder / "table.csv").is_file()


def test_the_search_once_called_frenetic_is_frenetic_2021(tmp_path: Path) -> None:
    with CampaignStore.open(copy("commanded", tmp_path)) as store:
        spec = Spec.from_json(store.config, source="a campaign")
    assert spec.strategy.name == "frenetic-2021"
    made = spec.make_strategy()
    assert isinstance(made, Frenetic2021)
    assert made.options == spec.strategy.made["options"]
    assert "frenetic-2021" in spec.run_words()


def test_the_entrant_once_called_frenetic_is_frenetic_2021(tmp_path: Path) -> None:
    (entrant,) = (e for e in Bench.open(copy("bench", tmp_path)).entrants if e.name == "evolved")
    assert entrant.spec == "frenetic-2021"
    assert entrant.options == {"max_redraws": 10, "random_budget": 0.5}
