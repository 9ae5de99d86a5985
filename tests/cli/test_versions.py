"""Two versions of a user's driver are told apart by every command."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from frenetic.campaign import CampaignStore
from frenetic.registry import USER_MODULE

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

DRIVER = """
from frenetic.drivers.driver import Controls
from gains import HEADING

class Mpc:
    def __init__(self, comfort=2.0):
        self._comfort = comfort
    def reset(self, setup):
        pass
    def act(self, o):
        steering = 3.5 * o.curvature_ahead[3] - 0.1 * o.lateral_offset - HEADING * o.heading_error
        return Controls(steering, 0.3 if o.speed < 17 else 0.0, 0.0)
"""
RUN = ("run", "--driver", "mpc.py:Mpc", "--simulations", "12", "--workers", "1", "--seed")


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A campaign of each of two versions of a driver, and the second version there now."""
    folder, path = tmp_path_factory.mktemp("versions"), list(sys.path)
    (folder / "mpc.py").write_text(DRIVER, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for heading, name in (("0.8", "old"), ("0.9", "new")):
            write_gains(folder, heading)
            prepare(*RUN, "3", "--out", name)
    forget()
    sys.path[:] = path
    return folder


@pytest.fixture
def versions(made: Path, tmp_path: Path) -> Iterator[Path]:
    """A copy of these in the folder of the command line."""
    path = list(sys.path)
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    yield tmp_path
    forget()
    sys.path[:] = path


def write_gains(folder: Path, heading: str) -> None:
    (folder / "gains.py").write_text(f"HEADING = {heading}  # rad/rad\n", encoding="utf-8")
    forget()


def forget() -> None:
    for name in [n for n in sys.modules if n == "gains" or n.startswith(USER_MODULE)]:
        del sys.modules[name]


def digest(folder: Path) -> str:
    with CampaignStore.open(folder) as store:
        driver: Any = store.config["driver"]
        return str(driver["fingerprint"]["digest"])


def test_show_and_report_say_which(frenetic: Frenetic, versions: Path) -> None:
    one, other = digest(versions / "old"), digest(versions / "new")
    assert one != other
    for folder, version in (("old", one), ("new", other)):
        assert f"driver     Mpc(comfort=2.0) [source {version}]" in frenetic("show", folder).out
        shown = frenetic("show", folder, "--json").json["config"]["driver"]
        assert shown["fingerprint"]["digest"] == version
        assert shown["options"] == {"comfort": 2.0}
        page = (versions / folder / "report.html").read_text(encoding="utf-8")
        assert f"mpc.py:Mpc, source {version}" in page


def test_compare_never_takes_them_for_repeats(frenetic: Frenetic, versions: Path) -> None:
    names = [f"Mpc [source {digest(versions / one)}]" for one in ("new", "old")]
    groups = frenetic("compare", "old", "new", "--json").json["groups"]
    assert sorted(groups) == sorted(names)
    refused = frenetic("compare", "old", "--json")
    assert refused.code == 2
    noted = frenetic("compare", "a=old", "b=new").err
    assert "the groups differ" not in noted


def test_resume_refuses_the_other_one(frenetic: Frenetic, versions: Path) -> None:
    refused = frenetic("resume", "old", "--simulations", "5")
    assert refused.refuses("driver Mpc: gains.py was changed", "frenetic run --from old")
    write_gains(versions, "0.8")
    assert frenetic("resume", "old", "--simulations", "5").code == 0


@pytest.mark.parametrize(
    "again",
    [
        ("robustness", "--times", "2", "--top", "1"),
        ("regression",),
        ("confirm", "--simulator-option", "friction=0.9", "--top", "1"),
        ("minimise", "--max-drives", "5"),
    ],
)
def test_driving_again_says_that_it_is_another(
    frenetic: Frenetic, versions: Path, again: tuple[str, ...], caplog: pytest.LogCaptureFixture
) -> None:
    command, *options = again
    forget()
    assert frenetic(command, "new", *options).code in (0, 1)
    assert "another version" not in caplog.text
    forget()
    assert frenetic(command, "old", *options).code in (0, 1)
    text = "driver Mpc is another version than the campaign's: gains.py was changed"
    assert [record.getMessage() for record in caplog.records].count(text) == 1


def test_a_bench_goes_on_with_the_same_version_only(frenetic: Frenetic, versions: Path) -> None:
    bench = ("bench", "--simulations", "3", "--repeats", "1", "--workers", "1", "--out", "b")
    assert frenetic(*bench, "--strategy", "random", "--driver", "mpc.py:Mpc").code == 0
    forget()
    assert frenetic("bench", "--resume", "--out", "b").code == 0
    write_gains(versions, "1.0")
    refused = frenetic("bench", "--resume", "--out", "b")
    assert refused.refuses("another driver: driver Mpc: gains.py was changed")
