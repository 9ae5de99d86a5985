"""Code that a file names is run only if the user names it, or has run that very source before."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from frenetic import trust
from frenetic.campaign import CampaignStore
from frenetic.errors import FreneticError
from frenetic.spec import Part, Spec

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

DRIVER = """
from pathlib import Path
from frenetic.drivers.driver import Controls

Path({marker!r}).touch()

class Theirs:
    def __init__(self, gain=3.5):
        self.gain = gain
    def reset(self, setup):
        pass
    def act(self, o):
        steering = self.gain * o.curvature_ahead[3] - 0.1 * o.lateral_offset
        return Controls(steering - 0.8 * o.heading_error, 0.3 if o.speed < 17 else 0.0, 0.0)
"""
NAMED = ("--driver", "theirs.py:Theirs")
FEW = ("--simulations", "12", "--workers", "1", "--seed", "3")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A stranger's campaign with the driver's file, and a campaign of the user's own."""
    folder = tmp_path_factory.mktemp("stranger")
    text = DRIVER.format(marker=str(folder / "was-here"))
    (folder / "theirs.py").write_text(text, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv(trust.VARIABLE, str(folder / "home of the stranger"))
        prepare("run", *FEW, *NAMED, "--out", "c")
        prepare("run", *FEW, "--criteria", "speed_limit=70", "--out", "own")
    return folder


@pytest.fixture
def received(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it for somebody else, who has run nothing yet; its driver's mark."""
    monkeypatch.setenv(trust.VARIABLE, str(tmp_path / "home"))
    for name in ("c", "own", "theirs.py"):
        copy: Any = shutil.copytree if (made / name).is_dir() else shutil.copy
        copy(made / name, tmp_path / name)
    mark = made / "was-here"
    mark.unlink(missing_ok=True)
    return mark


def a_failure() -> str:
    return str(min(Path("c/failures").glob("test-*.json")))


DRIVING: dict[str, Callable[[], tuple[str, ...]]] = {
    "drive": lambda: ("drive", a_failure()),
    "rerun": lambda: ("rerun", "c", "--top", "1"),
    "minimise": lambda: ("minimise", "c", "--max-drives", "3"),
}
"""Commands that drive, and take another driver."""
OTHERS: dict[str, Callable[[], tuple[str, ...]]] = {
    "resume": lambda: ("resume", "c", "--simulations", "1"),
    "compare": lambda: ("compare", "--fresh", "2", "c", "--driver", "planner"),
}


@pytest.mark.parametrize("command", [*DRIVING, *OTHERS])
def test_a_strangers_driver_is_refused_unrun(
    frenetic: Frenetic, received: Path, command: str
) -> None:
    refused = frenetic(*(DRIVING | OTHERS)[command]())
    assert refused.refuses("names the driver 'theirs.py:Theirs', code that you have not run")
    assert not received.exists()


@pytest.mark.parametrize("command", DRIVING)
def test_it_drives_once_the_command_names_it(
    frenetic: Frenetic, received: Path, command: str
) -> None:
    assert frenetic(*DRIVING[command](), *NAMED).code in (0, 1)
    assert received.exists()


def test_what_the_user_has_run_goes_on_unasked_until_it_is_edited(
    frenetic: Frenetic, received: Path
) -> None:
    assert frenetic("drive", a_failure(), *NAMED).code == 0
    for command in ("drive", *OTHERS):
        received.unlink()
        assert frenetic(*(DRIVING | OTHERS)[command]()).code in (0, 1, 3), command
        assert received.exists()
    file = Path("theirs.py")
    file.write_text(file.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert frenetic(*DRIVING["drive"]()).refuses("code that you have not run as it is")


@pytest.mark.parametrize(
    "words",
    [
        ("show", "c"),
        ("check", "c"),
        ("report", "c"),
        ("export", "c", "--format", "csv"),
        ("compare", "a=c", "b=own"),
    ],
)
def test_looking_at_a_campaign_runs_nothing_of_it(
    frenetic: Frenetic, received: Path, words: tuple[str, ...]
) -> None:
    assert frenetic(*words).code == 0
    assert not received.exists()


@pytest.mark.parametrize("command", ["resume", "rerun"])
def test_a_program_that_a_strangers_simulator_starts_is_refused(
    frenetic: Frenetic, received: Path, command: str
) -> None:
    with CampaignStore.open("own") as store:
        config: dict[str, Any] = json.loads(json.dumps(dict(store.config)))
    config["run"] |= {"simulator": "beamng,home=/opt/theirs"}
    shutil.rmtree("c")
    CampaignStore.create("c", config).close()
    refused = frenetic(*(DRIVING | OTHERS)[command]())
    assert refused.refuses("names the simulator 'beamng'")
    assert "--simulator beamng,home=/opt/theirs" in refused.err


def is_trusted(kind: str, name: str, **options: object) -> bool:
    spec = Spec(**{kind: Part(name, options)})  # type: ignore[arg-type]
    try:
        spec.require_trusted("c")
    except FreneticError:
        return False
    return True


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Of a user who has run nothing yet."""
    monkeypatch.setenv(trust.VARIABLE, str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "home"


@pytest.mark.usefixtures("home")
def test_built_in_parts_are_made_unasked_but_no_other_program() -> None:
    assert is_trusted("driver", "planner", aggression=1.2)
    assert is_trusted("strategy", "frenetic")
    assert is_trusted("simulator", "embedded", friction=0.5)
    assert is_trusted("simulator", "beamng", port=25252)
    for name in ("beamng", "frenetic.beamng:BeamngSimulator"):
        assert not is_trusted("simulator", name, home="/opt/b")
        trust.remember("simulator", name, {"home": "/opt/b"})
        assert is_trusted("simulator", name, home="/opt/b", headless=True)
        assert not is_trusted("simulator", name, home="/opt/c")


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("driver", "own.py:Own"),
        ("driver", "sub/own.py:Own"),
        ("strategy", "own:Own"),
        ("simulator", "sub.own:Own"),
        ("driver", "folder.own:Own"),
        ("driver", "frenetic.testing:DummyDriver"),
        ("driver", "net.onnx"),
        ("driver", "nowhere.py:Own"),
        ("driver", "somewhere_installed:Own"),
    ],
)
def test_any_other_part_is_asked_for_until_it_was_run(
    kind: str, name: str, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("sub", "folder"):
        Path(folder).mkdir()
    for file in ("own.py", "sub/own.py", "net.onnx", "sub/__init__.py", "folder/own.py"):
        Path(file).write_text("import near\nimport folder.own\n")
    for file in ("near.py", "sub/near.py"):
        Path(file).touch()
    assert not is_trusted(kind, name)
    trust.remember(kind, name, {})
    assert is_trusted(kind, name)
    monkeypatch.setenv(trust.VARIABLE, f"{home} of another")
    assert not is_trusted(kind, name)


def test_trust_follows_the_source_and_not_its_place(tmp_path: Path, home: Path) -> None:
    for place in ("here", "there"):
        Path(place).mkdir()
        Path(place, "own.py").write_text("import near\n")
        Path(place, "near.py").touch()
    names = [str(tmp_path / place / "own.py:Own") for place in ("here", "there")]
    trust.remember("driver", names[0], {})
    assert [is_trusted("driver", name) for name in names] == [True, True]
    Path("there", "near.py").write_text("GAIN = 2\n")
    assert [is_trusted("driver", name) for name in names] == [True, False]
    shutil.rmtree(home)
    home.touch()  # which cannot be written
    trust.remember("driver", names[0], {})
    assert not is_trusted("driver", names[0]), "it only asks again"
