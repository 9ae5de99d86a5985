"""Every command tells two versions of a user's driver apart, and can still drive the old one."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from user_modules import own_modules

from frenetic.campaign import CampaignStore, RoadTester
from frenetic.campaign.stored_spec import signed_spec
from frenetic.parts.records import short_version
from frenetic.rerun.old_version import as_recorded
from frenetic.spec import Spec

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

DRIVER = """
from frenetic.drivers.driver import Controls
from {}gains import HEADING

class Mpc:
    def __init__(self, comfort=2.0):
        self._comfort = comfort
    def reset(self, setup):
        pass
    def act(self, o):
        from {}gains import HEADING as now  # the module of this version, not of the other
        assert now == HEADING
        steering = 3.5 * o.curvature_ahead[3] - 0.1 * o.lateral_offset - HEADING * o.heading_error
        return Controls(steering, 0.3 if o.speed < 17 else 0.0, 0.0)
"""
RUN = ("run", "--simulations", "12", "--workers", "1", "--seed")
CAMPAIGNS = {"old": "mpc.py:Mpc", "module": "laws.mpc:Mpc", "new": "mpc.py:Mpc"}
"""Campaign -> its driver; the driver was edited before the campaign new."""


@pytest.fixture(scope="session")
def edited_campaigns(
    tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]
) -> Path:
    """Campaigns of two versions of a driver, in a file and in a package, now the second."""
    folder = tmp_path_factory.mktemp("versions")
    (folder / "laws").mkdir()
    (folder / "laws" / "__init__.py").touch()
    (folder / "mpc.py").write_text(DRIVER.format("", ""), encoding="utf-8")
    (folder / "laws" / "mpc.py").write_text(DRIVER.format(".", "."), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, driver in CAMPAIGNS.items():
            write_gains("0.9" if name == "new" else "0.8")
            prepare(*RUN, "3", "--driver", driver, "--out", name)
    return folder


@pytest.fixture(autouse=True)
def versions(edited_campaigns: Path, tmp_path: Path, frenetic: Frenetic) -> None:
    """Copies of these campaigns in the folder of the command line, signed as if run there."""
    shutil.copytree(edited_campaigns, tmp_path, dirs_exist_ok=True)
    for name in CAMPAIGNS:
        with CampaignStore.open(name, readonly=False) as store:
            signed = signed_spec(store).signed_in(tmp_path, store.fact("sources")).signed
            assert signed is not None
            store.keep(started_in=signed.folder, signature=signed.signature)
        Spec.read(f"{name}/campaign.toml").signed_in(tmp_path).write(Path(name))


def write_gains(heading: str) -> None:
    for file in ("gains.py", "laws/gains.py"):
        Path(file).write_text(f"HEADING = {heading}  # rad/rad\n", encoding="utf-8")
        # Python compares the times of source and bytecode in whole seconds.
        written = 1_700_000_000 + 100 * float(heading)  # s
        os.utime(file, (written, written))


def version(folder: str) -> str:
    with CampaignStore.open(folder) as store:
        return short_version(store.config["driver"])


@pytest.mark.heavy
def test_show_and_report_say_which_version_drove(frenetic: Frenetic) -> None:
    assert version("old") != version("new")
    for folder in ("old", "new"):
        assert f"mpc.py:Mpc [{version(folder)}]" in frenetic("show", folder).out
        shown = frenetic("show", folder, "--json").json["config"]["driver"]
        assert (shown["version"], shown["options"]) == (version(folder), {"comfort": 2.0})
        page = Path(folder, "report.html").read_text(encoding="utf-8")
        assert f"Mpc, {version(folder)}" in page


def test_a_campaign_keeps_its_sources() -> None:
    for folder, files in (
        ("old", {"mpc.py", "gains.py"}),
        ("module", {"laws/__init__.py", "laws/mpc.py", "laws/gains.py"}),
    ):
        with CampaignStore.open(folder) as store:
            sources: Any = store.fact("sources")
        assert sources.keys() == files
        assert {"HEADING = 0.8  # rad/rad\n"} <= set(sources.values())


def test_compare_never_takes_two_versions_for_repeats(frenetic: Frenetic) -> None:
    names = [f"Mpc [{version(folder)}]" for folder in ("new", "old")]
    assert sorted(frenetic("compare", "old", "new", "--json").json["groups"]) == sorted(names)
    assert frenetic("compare", "old", "--json").code == 2


@pytest.mark.parametrize(
    ("folder", "heading"), [("old", "0.9"), pytest.param("module", "1.1", marks=pytest.mark.heavy)]
)
def test_resume_refuses_an_edited_driver_and_advises_a_command(
    frenetic: Frenetic, folder: str, heading: str
) -> None:
    """The campaign new has the edited version of the file; no campaign has that of the package."""
    resume = ("resume", folder, "--simulations", "2")
    write_gains(heading)
    gains = "gains.py" if folder == "old" else "laws/gains.py"
    refused = frenetic(*resume)
    assert refused.refuses(f"{gains} was edited")
    (command,) = re.findall(
        "a new campaign from this one, with another seed so that its random roads are new:"
        " (frenetic .*)",
        refused.err,
    )
    words = shlex.split(command)
    start = ["frenetic", "run", f"{folder}/campaign.toml", "--from", folder]
    assert words == [*start, "--driver", CAMPAIGNS[folder], "--seed", "4"]
    assert frenetic(*words[1:], "--out", "next").code == 0
    write_gains("0.8  ")
    assert frenetic(*resume).refuses(f"{gains} was edited")
    write_gains("0.8")
    assert frenetic(*resume).code == 0


@pytest.mark.parametrize("folder", ["old", "module"])
def test_the_old_version_of_an_edited_driver_drives_as_it_did(folder: str) -> None:
    with CampaignStore.open(folder) as store:
        spec = signed_spec(store)
        tests = [test for test in store.tests() if test.outcome.is_driven]
    assert len(tests) == 12

    def equal_results(make: Callable[[], RoadTester]) -> list[bool]:
        with own_modules():
            tester = make()
            with tester.simulator:
                return [tester.test(test.candidate).result == test.result for test in tests]

    def old_tester() -> RoadTester:
        old.start()
        return old.tester()

    assert not all(equal_results(lambda: RoadTester.of(spec)))
    with as_recorded(folder, spec) as old:
        assert all(equal_results(old_tester))
    shutil.rmtree("laws")
    Path("mpc.py").unlink()
    with as_recorded(folder, spec) as old:
        assert all(equal_results(old_tester))


def test_the_old_version_does_not_import_from_the_folder_of_the_new(tmp_path: Path) -> None:
    with CampaignStore.open("old") as store:
        spec = signed_spec(store)
    with own_modules():
        RoadTester.of(spec)
        assert str(tmp_path) in sys.path
        with as_recorded("old", spec) as old:
            assert old.sources is not None
            old.start()
            assert sys.path[0] == str(old.sources)
            assert str(tmp_path) not in sys.path


def test_a_built_in_driver_beside_a_users_strategy_has_no_old_version(
    frenetic: Frenetic,
) -> None:
    """The sources in such a campaign belong to the strategy."""
    Path("plan.py").write_text("from frenetic import RandomSearch as Plan\n", encoding="utf-8")
    assert frenetic(*RUN, "3", "--strategy", "plan.py:Plan", "--out", "plan").code == 0
    compare = ("compare", "plan", "--driver", "stanley", "--fresh", "2")
    assert frenetic(*compare).code in (0, 1, 3)


def test_an_edited_driver_is_compared_with_its_recorded_version(frenetic: Frenetic) -> None:
    command = ("compare", "module", "--driver", CAMPAIGNS["module"], "--fresh", "3", "--json")
    compared = frenetic(*command).json
    assert compared["old"]["version"] == version("module")
    assert compared["new"]["version"] not in (version("module"), "")
    write_gains("0.8")
    same = frenetic(*command)
    assert same.refuses("both versions are the same")


@pytest.mark.parametrize(
    "words", [("rerun",), pytest.param(("minimise", "--max-drives", "5"), marks=pytest.mark.heavy)]
)
def test_rerun_and_minimise_warn_of_another_version(
    frenetic: Frenetic, words: tuple[str, ...], caplog: pytest.LogCaptureFixture
) -> None:
    command, *options = words
    assert frenetic(command, "new", *options).code in (0, 1)
    assert "another version" not in caplog.text
    assert frenetic(command, "old", *options).code in (0, 1)
    text = "driver Mpc is another version than the campaign's: it is {}, it was {}"
    messages = [record.getMessage() for record in caplog.records]
    assert messages.count(text.format(version("new"), version("old"))) == 1


@pytest.mark.heavy
def test_a_bench_goes_on_with_the_same_version_only(frenetic: Frenetic) -> None:
    bench = ("bench", "--simulations", "3", "--repeats", "1", "--workers", "1", "--out", "b")
    assert frenetic(*bench, "--strategy", "random", "--driver", "mpc.py:Mpc").code == 0
    assert frenetic("bench", "--resume", "--out", "b").code == 0
    write_gains("0.8")
    assert frenetic("bench", "--resume", "--out", "b").refuses("another driver: driver Mpc: it is")
