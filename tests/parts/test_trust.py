"""Code that a file names is loaded only if the user has signed it, listed it, or names it."""

from __future__ import annotations

import json
import os
import py_compile
import secrets
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import chdir, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest
from user_modules import own_modules

from frenetic.campaign import CampaignStore
from frenetic.errors import FreneticError
from frenetic.parts import allowed_files, signatures, trust
from frenetic.parts.named_code import REGISTRIES, Parts, named_code
from frenetic.parts.trust import CodeClaim
from frenetic.plugins.twin.profile import TwinProfile
from frenetic.spec import Spec

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

DRIVER = """
from frenetic.drivers.driver import Controls
from near import GAIN

class Mine:
    def __init__(self, gain=GAIN):
        self.gain = gain
    def reset(self, setup):
        pass
    def act(self, o):
        steering = self.gain * o.curvature_ahead[3] - 0.1 * o.lateral_offset
        return Controls(steering - 0.8 * o.heading_error, 0.3 if o.speed < 17 else 0.0, 0.0)

def run(*args, **options):
    return Mine()
"""
NEAR = "GAIN = 3.5\n"
MARKING = """
import os
from pathlib import Path

with Path({mark!r}).open("a") as file:
    file.write(f"{{os.getpid()}} ")
"""
PARENT = f"{os.getpid()} "
OWN_DRIVER = ("--driver", "mine.py:Mine")
SHORT_SEARCH = ("--simulations", "12", "--workers", "1", "--seed", "3")
FEW_FRESH_ROADS = ("--fresh", "2")


def write_marking(file: Path, mark: Path, text: str = "") -> None:
    """Write a module that appends the id of its process to a file when it is loaded."""
    file.parent.mkdir(exist_ok=True)
    source = file.with_suffix(".py")
    source.write_text(MARKING.format(mark=str(mark)) + text, encoding="utf-8")
    if file.suffix == ".pyc":
        py_compile.compile(str(source), str(file))
        source.unlink()


@pytest.fixture(scope="module")
def users_folder(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A folder of the user with a driver of their own and a campaign `c` of that driver."""
    folder = tmp_path_factory.mktemp("mine")
    (folder / "mine.py").write_text(DRIVER, encoding="utf-8")
    (folder / "near.py").write_text(NEAR, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch, chdir(folder):
        patch.setenv(signatures.HOME_VARIABLE, str(folder / "home"))
        prepare("run", *SHORT_SEARCH, *OWN_DRIVER, "--out", "c")
    return folder


@pytest.fixture
def user(users_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the user, whose commands run in another folder now."""
    monkeypatch.setenv(signatures.HOME_VARIABLE, str(users_folder / "home"))
    return users_folder


@pytest.fixture
def mark(tmp_path: Path) -> Path:
    """A file that foreign code makes where it is loaded."""
    return tmp_path / "was-here"


@pytest.fixture
def received(
    users_folder: Path, tmp_path: Path, mark: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """A copy of that campaign for another user, beside code that makes a file; that file."""
    monkeypatch.setenv(signatures.HOME_VARIABLE, str(tmp_path / "home"))
    copy_with_marks(users_folder, tmp_path, mark)
    return mark


def copy_with_marks(users_folder: Path, folder: Path, mark: Path) -> None:
    """Copy the campaign and its driver beside modules that make a file."""
    shutil.copytree(users_folder / "c", folder / "c")
    shutil.copy(users_folder / "mine.py", folder)
    write_marking(folder / "near.py", mark, NEAR)
    write_marking(folder / "colorsys.pyc", mark)


def failing_road(campaign: Path | str = "c") -> str:
    return str(min(Path(campaign, "failures").glob("test-*.json")))


def commands(campaign: Path | str = "c") -> dict[str, tuple[str, ...]]:
    """Commands that load code that a file or campaign names."""
    campaign = str(campaign)
    return {
        "drive": ("drive", failing_road(campaign)),
        "drive a test": ("drive", campaign, "1"),
        "drive as": ("drive", "road.json", "--as", f"{campaign}/campaign.toml"),
        "rerun": ("rerun", campaign, "--top", "1"),
        "minimise": ("minimise", campaign, "--max-drives", "3"),
        "run": ("run", f"{campaign}/campaign.toml", "--out", "again"),
        "resume": ("resume", campaign, "--simulations", "1"),
        "compare": ("compare", campaign, "--driver", "planner", *FEW_FRESH_ROADS),
    }


COMMANDS: Final = ("drive", "drive a test", "drive as", "rerun", "minimise", "run", "resume")
"""These commands but for compare, whose ``--driver`` is the new version."""


def mostly_heavy(*light: str, without: Collection[str] = ()) -> list[Any]:
    """Return the commands as parameters of a test; all but the light ones are heavy."""
    commands = [name for name in (*COMMANDS, "compare") if name not in without]
    return [
        name if name in light else pytest.param(name, marks=pytest.mark.heavy) for name in commands
    ]


def write_road() -> None:
    text = json.dumps({"curvatures": [0, 0.01, 0.02, 0.02, 0.01, 0]})
    Path("road.json").write_text(text, encoding="utf-8")


def change_fact(campaign: Path | str, name: str, change: Callable[[Any], Any]) -> None:
    """Change a fact in the database of a campaign."""
    with closing(sqlite3.connect(Path(campaign, "campaign.sqlite"))) as database, database:
        (text,) = database.execute("SELECT value FROM fact WHERE name = ?", (name,)).fetchone()
        value = json.dumps(change(json.loads(text)))
        database.execute("UPDATE fact SET value = ? WHERE name = ?", (value, name))


# Campaigns of the user


@pytest.mark.parametrize("command", mostly_heavy("rerun", "run"))
@pytest.mark.parametrize("is_there", [True, False])
def test_a_users_campaign_needs_no_trust_and_loads_code_of_its_folder_only(
    frenetic: Frenetic, user: Path, mark: Path, tmp_path: Path, command: str, is_there: bool
) -> None:
    """The command runs in that folder, or in another, beside a copy with other code."""
    current = user if is_there else tmp_path
    copy_with_marks(user, tmp_path, mark)
    out = ("--out", str(tmp_path / "new")) if command == "run" else ()
    with chdir(current):
        write_road()
        answer = frenetic(*commands()[command], *out)
    assert answer.code in (0, 1, 3), answer.err
    assert (f"mine.py:Mine is loaded from {user}" in answer.err) is not is_there
    assert not mark.exists()


@pytest.mark.parametrize("command", [*COMMANDS, "compare"])
def test_code_whose_folder_is_gone_is_refused_in_one_line(
    frenetic: Frenetic, user: Path, mark: Path, tmp_path: Path, command: str
) -> None:
    copy_with_marks(user, tmp_path, mark)
    write_road()
    gone = user.rename(f"{user}-gone")
    os.environ[signatures.HOME_VARIABLE] = str(gone / "home")
    try:
        refused = frenetic(*commands()[command])
    finally:
        gone.rename(user)
    assert refused.refuses("the driver 'mine.py:Mine', code that was in", "no folder now")
    assert not mark.exists()


def test_an_edited_driver_is_refused_by_resume_with_the_next_command(
    frenetic: Frenetic, user: Path
) -> None:
    try:
        (user / "near.py").write_text("GAIN = 3.4\n", encoding="utf-8")
        refused = frenetic("resume", str(user / "c"), "--simulations", "1")
        words = f"near.py was edited after {user}/c began: restore it"
        assert refused.refuses(words, f"frenetic run {user}/c/campaign.toml --from {user}/c")
        assert frenetic("drive", failing_road(user / "c")).code in (0, 1), (
            "the signature still holds"
        )
    finally:
        (user / "near.py").write_text(NEAR, encoding="utf-8")


def test_a_campaign_from_python_is_signed(tmp_path: Path, user: Path) -> None:
    import frenetic

    with chdir(user), own_modules():
        spec = Spec(driver="mine.py:Mine", simulations=3, seed=1)
        campaign = frenetic.Campaign.of(spec, folder=tmp_path / "c", workers=1)
        campaign.run()
    with CampaignStore.open(tmp_path / "c") as store:
        signature: Any = store.fact("signature")
        sources = store.fact("sources")
        assert "signature" not in store.facts
        assert signatures.is_signed(signature, part("driver", "mine.py:Mine"), user, sources)
        assert "signed" not in json.dumps(dict(store.config))
    read = Spec.read(tmp_path / "c" / "campaign.toml")
    assert read.signed is not None
    assert trust.require_trusted("c", read.code_claim()) == user
    assert Spec.of(read).signed is None, "a merged spec is not signed"


def test_a_part_that_the_command_names_comes_from_the_current_folder(
    frenetic: Frenetic, user: Path, tmp_path: Path
) -> None:
    """Also if another part comes from the folder of the campaign."""
    shutil.copytree(user / "c", "c")
    Path("near.py").write_text("GAIN = 3.4\n", encoding="utf-8")
    shutil.copy(user / "mine.py", tmp_path)
    answer = frenetic("rerun", "c", "--top", "1", "--driver", "mine.py:Mine,gain=3.3", "--json")
    assert answer.json["driver"]["options"] == {"gain": 3.3}
    assert "is loaded from" not in answer.err
    (user / "plan.py").write_text("from frenetic import RandomSearch as Plan\n", encoding="utf-8")
    with chdir(user):
        plan = ("--strategy", "plan.py:Plan")
        out = ("--out", str(tmp_path / "d"))
        assert frenetic("run", *SHORT_SEARCH, *OWN_DRIVER, *plan, *out).code == 0
    answer = frenetic("run", "d/campaign.toml", *OWN_DRIVER, "--out", "e")
    assert f"plan.py:Plan is loaded from {user}" in answer.err
    assert "mine.py:Mine is loaded" not in answer.err
    with CampaignStore.open("e") as store:
        spec: Any = store.config["spec"]
        assert (spec["driver"], spec["strategy"]) == (f"{tmp_path}/mine.py:Mine", "plan.py:Plan")
        sources: Any = store.fact("sources")
        assert sources["near.py"] == "GAIN = 3.4\n"


# Campaigns of somebody else


@pytest.mark.parametrize("command", [*COMMANDS, "compare"])
def test_a_strangers_driver_is_refused_and_not_loaded(
    frenetic: Frenetic, received: Path, command: str
) -> None:
    write_road()
    refused = frenetic(*commands()[command])
    assert refused.refuses("names the driver 'mine.py:Mine', code that you have not trusted")
    is_named = command not in ("resume", "compare")
    assert ("name it yourself, --driver mine.py:Mine, or add --trust" in refused.err) is is_named
    assert not received.exists()


@pytest.mark.parametrize("command", mostly_heavy("drive", "run", without=("resume", "compare")))
def test_a_strangers_driver_drives_only_in_commands_that_name_it(
    frenetic: Frenetic, received: Path, command: str
) -> None:
    """A TOML file, which people write, needs its driver named only once."""
    write_road()
    assert frenetic(*commands()[command], *OWN_DRIVER).code in (0, 1)
    assert received.exists()
    received.unlink()
    shutil.rmtree("again", ignore_errors=True)
    is_toml = command in ("run", "drive as")
    assert (frenetic(*commands()[command]).code in (0, 1)) is is_toml
    assert received.exists() is is_toml


@pytest.mark.parametrize("command", mostly_heavy("rerun", "resume"))
def test_trust_signs_a_strangers_driver_for_later_commands(
    frenetic: Frenetic, received: Path, command: str
) -> None:
    write_road()
    if command == "resume":  # resume refuses an edited driver
        Path("near.py").write_text(NEAR, encoding="utf-8")
    assert frenetic(*commands()[command], "--trust").code in (0, 1, 3)
    received.unlink(missing_ok=True)
    shutil.rmtree("again", ignore_errors=True)
    assert frenetic(*commands()[command]).code in (0, 1, 3)
    assert received.exists() is (command not in ("compare", "resume")), (
        "the driver is loaded from the current folder"
    )
    if command in ("rerun", "compare"):
        Path("near.py").write_text(NEAR, encoding="utf-8")
        assert frenetic("resume", "c", "--simulations", "1").code == 0, "the campaign is trusted"


@pytest.mark.parametrize(
    "words",
    [
        ("show", "c"),
        ("show", "c", "1", "--json"),
        ("check", "c"),
        ("report", "c"),
        ("export", "c", "--format", "competition"),
        pytest.param(("export", "c", "--format", "csv"), marks=pytest.mark.heavy),
        ("drive", "c", "1", "--dry"),
    ],
)
def test_looking_at_a_campaign_loads_none_of_its_code(
    frenetic: Frenetic, received: Path, words: tuple[str, ...]
) -> None:
    answer = frenetic(*words)
    assert answer.code == 0
    assert "signature" not in answer.out, "looking signs nothing"
    assert not received.exists()


def test_a_program_that_a_strangers_simulator_starts_is_refused(
    frenetic: Frenetic, received: Path
) -> None:
    change_fact("c", "config", with_entry("simulator", "beamng,home=/opt/theirs"))
    refused = frenetic(*commands()["rerun"], *OWN_DRIVER)
    assert refused.refuses("the simulator 'beamng'", "--simulator beamng,home=/opt/theirs")
    # `resume` has no option for the driver, so naming the simulator alone would not help.
    refused = frenetic(*commands()["resume"])
    assert refused.refuses("the simulator 'beamng'", "if you do, add --trust")
    assert not received.exists()


@pytest.mark.parametrize("kind", ["driver", "strategy", "simulator"])
def test_a_program_that_a_stranger_names_is_refused_in_full(
    frenetic: Frenetic, received: Path, kind: str
) -> None:
    text = "command:touch started --now"
    change_fact("c", "config", with_entry(kind, text))
    refused = frenetic(*commands()["resume"])
    assert refused.refuses(f"the {kind} '{text}'", "add --trust")
    assert not Path("started").exists()
    assert not received.exists()


def test_a_strangers_scheduler_is_refused_until_it_is_named(
    frenetic: Frenetic, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask loads code that the scheduler sends."""
    monkeypatch.setenv(signatures.HOME_VARIABLE, str(tmp_path / "home"))
    Path("own.toml").write_text("workers = 'tcp://127.0.0.1:1'\nsimulations = 3\n")
    refusal = frenetic("run", "own.toml")
    assert refusal.refuses("names the workers 'tcp://127.0.0.1:1'", "--workers tcp://127.0.0.1:1")
    for options in (("--workers", "tcp://127.0.0.1:1"), ()):
        assert frenetic("run", "own.toml", *options).refuses("no Dask scheduler"), (
            "once it was named"
        )
    assert frenetic("run", "own.toml", "--workers", "1", "--out", "c").code == 0


def with_entry(name: str, value: object) -> Callable[[Any], Any]:
    """Return a function that changes an entry of the spec in a campaign's configuration."""
    return lambda config: {**config, "spec": {**config["spec"], name: value}}


# Attacks without a change of the driver's file


@pytest.mark.heavy
@pytest.mark.parametrize("workers", ["1", "2"])
def test_files_beside_a_users_part_do_not_replace_our_imports(
    workers: str, tmp_path: Path, mark: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In fresh processes, which have imported neither module before."""
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(
        "from frenetic import RandomSearch as S\n\ndef f(road, drive):\n    return road.length\n",
        encoding="utf-8",
    )
    for name in ("matplotlib.py", "glob.py"):
        write_marking(Path(name), mark)
    parts = ("--strategy", "own.py:S", "--objective", "own.py:f", "--driver", "planner")
    search = ("--simulations", "6", "--workers", workers, "--seed", "3", "--out", "c")
    for words in (("run", *parts, *search), ("report", "c"), ("show", "c", "1")):
        subprocess.run(["frenetic", *words], check=True, capture_output=True)
    assert Path("c/report.html").exists()
    assert not mark.exists()


def test_recorded_sources_run_in_another_process_and_only_if_trusted(
    frenetic: Frenetic, received: Path
) -> None:
    text = MARKING.format(mark=str(received)) + NEAR
    change_fact("c", "sources", lambda sources: {**sources, "near.py": text})
    Path("near.py").write_text("GAIN = 3.4\n", encoding="utf-8")
    compare = commands()["compare"]
    assert frenetic(*compare).refuses("code that you have not trusted", "add --trust")
    assert not received.exists()
    assert frenetic(*compare, "--trust").code in (0, 1, 3)
    assert received.exists()
    assert PARENT not in received.read_text()


def test_a_recorded_source_that_somebody_changed_is_refused(
    frenetic: Frenetic, user: Path, mark: Path
) -> None:
    shutil.copytree(user / "c", "c")
    text = MARKING.format(mark=str(mark)) + NEAR
    change_fact("c", "sources", lambda sources: {**sources, "near.py": text})
    for command in ("compare", "rerun", "resume"):
        assert frenetic(*commands()[command]).refuses("names the driver 'mine.py:Mine'")
    assert not mark.exists()


@pytest.mark.parametrize("option", ["python", "copy", "pipeline", "path"])
def test_a_strangers_bench_is_refused_until_it_is_named_or_trusted(
    frenetic: Frenetic, tmp_path: Path, mark: Path, option: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(signatures.HOME_VARIABLE, str(tmp_path / "home"))
    folder = tmp_path / "theirs"
    write_marking(folder / "gen.py", mark, "class Gen: pass\n")
    value = sys.executable if option == "python" else str(folder)
    generator = f"{folder}/gen.py:Gen,{option}={value}"
    Path("b.toml").write_text(f"generator = ['{generator}']\nsimulations = 2\nrepeats = 1\n")
    for words_of_parts in (("b.toml",), ("b.toml", "--strategy", "own.py:S")):
        named = "--strategy" in words_of_parts
        answer = frenetic("bench", *words_of_parts, "--out", "b")
        words = "own.py" if named else "b.toml names the generator"
        assert answer.refuses(words), answer.err
    assert not mark.exists()
    trusted = ("--generator", generator) if option in ("python", "path") else ("--trust",)
    assert not frenetic("bench", "b.toml", *trusted, "--out", "b").refuses("not trusted")
    assert not frenetic("bench", "b.toml", "--out", "b").refuses("not trusted"), "now it is trusted"
    assert mark.exists() is (option != "pipeline"), "the folder holds no pipeline"


@pytest.mark.heavy
def test_the_users_bench_goes_on_until_somebody_edits_a_part(
    frenetic: Frenetic, user: Path, mark: Path, tmp_path: Path
) -> None:
    small = ("--simulations", "2", "--repeats", "1", "--workers", "1")
    with chdir(user):
        parts = ("--strategy", "random", *OWN_DRIVER)
        words = ("bench", *parts, *small, "--out", str(tmp_path / "b"))
        assert frenetic(*words).code in (0, 1)
    copy_with_marks(user, tmp_path, mark)
    file, resume = Path("b/bench.toml"), ("bench", "--resume", "--out", "b")
    assert f"the code of b is loaded from {user}" in frenetic(*resume).err
    repeated = frenetic("bench", "b/bench.toml", "--out", "b2")
    assert repeated.code in (0, 1)
    assert f"mine.py:Mine is loaded from {user}" in repeated.err
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("patience = 600.0", "patience = 500.0"), encoding="utf-8")
    assert frenetic("bench", "b/bench.toml", "--out", "b3").code in (0, 1), (
        "this edit names no code"
    )
    for old, new in (
        ('"random,name=random"', '"own.py:S,name=random"'),
        ('driver = "mine.py:Mine"', 'driver = "mine.py:run"'),
        (str(user), str(tmp_path)),
    ):
        assert old in text
        file.write_text(text.replace(old, new), encoding="utf-8")
        for command in (("bench", "b/bench.toml", "--out", "b4"), resume):
            assert frenetic(*command).refuses("bench.toml names the", "have not trusted")
    assert not mark.exists()


@pytest.mark.parametrize("source", ["named", "TOML", "trusted"])
def test_a_package_called_model_is_not_loaded_for_a_file_of_data(
    frenetic: Frenetic, tmp_path: Path, mark: Path, source: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(signatures.HOME_VARIABLE, str(tmp_path / "home"))
    write_marking(tmp_path / "model" / "onnx.py", mark, "class Own: pass\n")
    (tmp_path / "model" / "__init__.py").touch()
    Path("model.onnx").touch()
    Path("own.toml").write_text("driver = 'model.onnx:Own'\n", encoding="utf-8")
    options = {"named": ("--driver", "model.onnx:Own"), "TOML": ("own.toml",)}
    words = options.get(source, ("own.toml", "--trust"))
    refused = frenetic("run", *words, *SHORT_SEARCH)
    is_untrusted = source == "TOML"
    assert refused.refuses("not trusted" if is_untrusted else "a file of data has no class 'Own'")
    assert not mark.exists()


@pytest.mark.heavy
def test_an_installed_driver_needs_no_trust_beside_a_folder_of_its_name(
    frenetic: Frenetic, tmp_path: Path, mark: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = tmp_path / "site-packages"
    info = site / "watchful_drivers-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: watchful-drivers\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[frenetic.drivers]\nwatchful = watchful:Watchful\n")
    (site / "watchful.py").write_text(
        "from frenetic import Planner\n\nclass Watchful(Planner): pass\n"
    )
    monkeypatch.syspath_prepend(str(site))
    write_marking(tmp_path / "watchful" / "__init__.py", mark, "class Watchful: pass\n")
    Path("own.toml").write_text("driver = 'watchful'\n", encoding="utf-8")
    assert frenetic("run", "own.toml", *SHORT_SEARCH, "--out", "c").code == 0, (
        "an installed driver is trusted"
    )
    with CampaignStore.open("c") as store:
        driver: Any = store.config["driver"]
    assert driver["class"] == "watchful:Watchful"
    assert not mark.exists()


@pytest.mark.parametrize(
    "driver",
    ['mine.py:run,args=["rm"]', "mine.py:Mine,gain=3.0", "subprocess:run,args=rm", "near.py:Own"],
)
def test_an_edited_record_of_a_users_campaign_is_refused(
    frenetic: Frenetic, user: Path, driver: str
) -> None:
    """Database, TOML file and files of failing roads."""
    shutil.copytree(user / "c", "c")
    write_road()
    change_fact("c", "config", with_entry("driver", driver))
    for file in (Path("c/campaign.toml"), *Path("c/failures").glob("*.json")):
        text = file.read_text(encoding="utf-8")
        quoted = json.dumps(driver)
        file.write_text(
            text.replace('"driver": "mine.py:Mine"', f'"driver": {quoted}').replace(
                'driver = "mine.py:Mine"', f"driver = '{driver}'"
            ),
            encoding="utf-8",
        )
    name = driver.partition(",")[0]
    for command in (*COMMANDS, "compare"):
        refused = frenetic(*commands()[command])
        assert refused.refuses(f"names the driver '{name}'", "have not trusted"), command
    assert frenetic("drive", "road.json", "--as", failing_road()).refuses("have not trusted")


# Without signatures


def test_runs_are_not_signed_if_the_users_folder_cannot_be_written(
    frenetic: Frenetic, user: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "home").touch()
    monkeypatch.setenv(signatures.HOME_VARIABLE, str(tmp_path / "home"))
    for file in ("mine.py", "near.py"):
        shutil.copy(user / file, tmp_path)
    answer = frenetic("run", *SHORT_SEARCH, *OWN_DRIVER, "--out", "c")
    assert answer.code == 0
    assert answer.err.count(signatures.HOME_VARIABLE) == 1
    assert "signed" not in Path("c/campaign.toml").read_text(encoding="utf-8")
    assert frenetic("rerun", "c", "--top", "1").refuses("have not trusted")
    for options in (OWN_DRIVER, ("--trust",)):
        assert frenetic("rerun", "c", "--top", "1", *options).code in (0, 1)
    built_in = frenetic("run", *SHORT_SEARCH, "--out", "d")
    assert signatures.HOME_VARIABLE not in built_in.err, "built-in parts need no signature"


def test_a_profile_is_signed_and_loaded_from_its_folder_only(
    tmp_path: Path, user: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with chdir(user):
        profile = TwinProfile.of("twin", Spec(driver="mine.py:Mine"))
    profile.write(tmp_path / "twin.json")
    monkeypatch.chdir(tmp_path)
    read = TwinProfile.read("twin.json")
    assert read.spec().driver == f"{user}/mine.py:Mine"
    signed = {**read.driven, "driver": "mine.py:run"}
    with pytest.raises(
        FreneticError, match=f"not trusted: if you do, go to where it was as that says, {user}, and"
    ):
        TwinProfile(name="twin", driven=signed).spec()
    assert (
        TwinProfile(name="twin", driven={**read.driven, "signed": None}).digest() == read.digest()
    )


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for the key of a user who has run nothing yet."""
    monkeypatch.setenv(signatures.HOME_VARIABLE, str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "home"


# Signatures, the list of allowed files, and what counts as code

CODE: Final[Parts] = {"driver": ("theirs.py:Theirs", {"gain": 2.0})}
CLAIM: Final = CodeClaim(CODE)
SOURCES: Final = {"theirs.py": "import near", "near.py": "GAIN = 1"}


def part(kind: str, name: str, **options: object) -> Parts:
    """A mapping with one part and its options."""
    return {kind: (name, options)}


@pytest.mark.parametrize(
    "parts",
    [
        part("driver", "planner", aggression=1.2),
        part("driver", "dave2"),
        part("strategy", "frenetic", likely=True, step=None),
        part("objective", "oob-share"),
        part("simulator", "embedded", friction=0.5, vehicle="etk800"),
        part(
            "simulator", "beamng", host="pc.home.arpa", port=25252, level="tech_ground", home=None
        ),
        {"driver": ("stanley", {}), "simulator": ("metadrive", {"friction": 0.8})},
        {"strategy 1": ("random", {}), "strategy 2": ("frenetic", {"likely": True})},
    ],
)
def test_built_in_and_installed_parts_with_plain_options_name_no_code(parts: Parts) -> None:
    assert named_code(parts) == {}
    assert trust.require_trusted("c", CodeClaim(parts)) == Path.cwd()
    assert signatures.sign(named_code(parts), ".") == ""


@pytest.mark.parametrize(
    "name",
    [
        *("own.py:Own", "own:Own", "sub.own:Own", "net.onnx", "subprocess:run", "nowhere"),
        *("frenetic.testing:DummyDriver", "frenetic.drivers:Planner", "model.onnx:Own"),
    ],
)
@pytest.mark.parametrize("kind", ["driver", "simulator", "strategy", "objective", "generator 3"])
def test_any_other_part_names_code_with_all_its_options(kind: str, name: str) -> None:
    parts = part(kind, name, gain=2, mode="fast")
    assert named_code(parts) == parts


@pytest.mark.parametrize(
    ("kind", "name", "options"),
    [
        ("simulator", "beamng", {"home": "b"}),
        ("simulator", "beamng", {"user": "b"}),
        ("driver", "metadrive-policy", {"weights": "policy.npz"}),
        ("strategy", "foresight", {"profile": "models/twin"}),
        ("strategy", "foresight", {"profile": ["twin.json"]}),
        ("driver", "planner", {"law": {"model": "net.onnx"}}),
        ("driver", "planner", {"law": "~"}),
        ("driver", "planner", {"law": Path("law")}),
        ("driver", "planner", {"law": "C:\\laws"}),
        ("generator", "wiggly:Wiggly", {"python": "/opt/python", "copy": "/opt/wiggly"}),
    ],
)
def test_an_option_that_names_a_program_or_a_file_names_code(
    kind: str, name: str, options: Mapping[str, object]
) -> None:
    code = named_code(part(kind, name, **options, speed=3, mode="fast"))
    expected = options if kind != "generator" else {**options, "speed": 3, "mode": "fast"}
    assert code == {kind: (name, expected)}


def arguments(**changes: object) -> dict[str, Any]:
    """Arguments of `signatures.sign` and `signatures.is_signed`, with changes."""
    return {"code": CODE, "folder": "here", "sources": SOURCES, **changes}


@pytest.mark.usefixtures("home")
def test_a_signature_covers_code_folder_and_sources() -> None:
    signature = signatures.sign(**arguments())
    assert signature
    assert signatures.is_signed(signature, **arguments())
    assert signatures.is_signed(signature, **arguments(folder=Path("here").absolute()))
    read: Any = json.loads(json.dumps(arguments()))
    assert signatures.is_signed(signature, **read), "also after a round trip through JSON"
    for changes in (
        {"code": part("driver", "theirs.py:run", gain=2.0)},
        {"code": part("driver", "theirs.py:Theirs", gain=2.0, args=["rm"])},
        {"code": part("driver", "theirs.py:Theirs")},
        {"code": part("strategy", "theirs.py:Theirs", gain=2.0)},
        {"code": {**CODE, **part("simulator", "beamng", home="/opt/b")}},
        {"folder": "there"},
        {"folder": None},
        {"sources": {**SOURCES, "near.py": "GAIN = 2"}},
        {"sources": {**SOURCES, "glob.py": ""}},
        {"sources": None},
        {"sources": ["near.py"]},
    ):
        assert not signatures.is_signed(signature, **arguments(**changes)), changes
    for other in (None, 7, "", "é", "\ud800", signature.upper(), signature[:-1], [signature]):
        assert not signatures.is_signed(other, **arguments()), other


def test_another_user_has_another_key(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    signature = signatures.sign(**arguments())
    monkeypatch.setenv(signatures.HOME_VARIABLE, f"{home} of another")
    assert not signatures.is_signed(signature, **arguments())
    assert not Path(f"{home} of another").exists(), "is_signed makes no key"
    assert signatures.sign(**arguments()) != signature
    assert not signatures.is_signed(signature, **arguments())


def test_a_signature_ends_when_its_link_leads_to_another_folder(tmp_path: Path, home: Path) -> None:
    del home
    for name in ("mine", "theirs"):
        Path(name).mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "mine")
    signature = signatures.sign(**arguments(folder=link))
    assert signatures.is_signed(signature, **arguments(folder=link))
    link.unlink()
    link.symlink_to(tmp_path / "theirs")
    assert not signatures.is_signed(signature, **arguments(folder=link))


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such modes")
@pytest.mark.parametrize("has_links", [True, False])
def test_the_key_is_readable_by_its_user_alone(
    home: Path, has_links: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = os.umask(0)
    try:
        if not has_links:
            monkeypatch.setattr(os, "link", refuse)
        assert signatures.sign(**arguments())
        allowed_files.allow("run.toml", CODE)
    finally:
        os.umask(before)
    assert sorted(file.name for file in home.iterdir()) == ["allowed", "key"]
    assert [file.stat().st_mode & 0o777 for file in home.iterdir()] == [0o600, 0o600]
    assert home.stat().st_mode & 0o777 == 0o700


def refuse(*_: object) -> None:
    raise OSError("not on this file system")


@pytest.mark.parametrize("has_links", [True, False])
def test_the_second_process_uses_the_key_of_the_first(
    home: Path, has_links: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = []
    with monkeypatch.context() as patch:
        if not has_links:
            patch.setattr(os, "link", refuse)
        random = secrets.token_hex

        def token(size: int) -> str:
            """Another process makes the key at the last moment."""
            patch.setattr(secrets, "token_hex", random)
            results.append(signatures.sign(**arguments()))
            return random(size)

        patch.setattr(secrets, "token_hex", token)
        results.append(signatures.sign(**arguments()))
    assert results == [signatures.sign(**arguments())] * 2
    assert [file.name for file in home.iterdir()] == ["key"]


def test_processes_that_start_together_share_one_key(home: Path) -> None:
    code = (
        "import sys; from frenetic.parts import signatures; print(signatures.user_folder());"
        " sys.stdin.read(); print(signatures.sign({'driver': ('own.py:Own', {})}, '.'))"
    )
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen([sys.executable, "-c", code], **pipes) for _ in range(3)]
    for process in processes:
        assert process.stdout is not None
        process.stdout.readline()  # it has imported frenetic
    with ThreadPoolExecutor() as threads:
        lines = {out for out, _ in threads.map(subprocess.Popen.communicate, processes)}
    assert lines == {f"{signatures.sign({'driver': ('own.py:Own', {})}, '.')}\n"}
    assert [file.name for file in home.iterdir()] == ["key"]


@pytest.mark.parametrize("damage", ["a file", "garbage", "too short", "a folder", "no home"])
def test_without_a_key_nothing_is_signed_and_one_line_says_what_to_do(
    damage: str, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if damage == "a file":
        home.touch()
    elif damage == "no home":
        monkeypatch.setattr(
            signatures, "user_folder", lambda: Path("~nobody-of-this-name").expanduser()
        )
    else:
        home.mkdir()
        text = {"garbage": b"\xff\x00", "too short": b"00" * 31}.get(damage)
        (home / "key").mkdir() if text is None else (home / "key").write_bytes(text)
    assert signatures.sign(**arguments()) is None
    assert not signatures.is_signed("00" * 32, **arguments())
    assert signatures.HOME_VARIABLE in signatures.unsigned_text()
    assert "\n" not in signatures.unsigned_text()
    with pytest.raises(FreneticError, match="code that you have not trusted"):
        trust.require_trusted("c", CLAIM)
    assert trust.require_trusted("c", CLAIM, is_trusted=True) == Path.cwd()


@pytest.mark.usefixtures("home")
def test_an_allowed_file_is_no_longer_allowed_after_a_part_changes() -> None:
    Path("there").mkdir()
    assert not allowed_files.is_allowed("run.toml", CODE)
    assert allowed_files.allow("run.toml", CODE)
    assert allowed_files.is_allowed(Path("run.toml").absolute(), CODE)
    for other in (
        {"path": "other.toml"},
        {"code": part("driver", "theirs.py:run", gain=2.0)},
        {"code": part("driver", "theirs.py:Theirs", gain=3.0)},
        {"folder": "there"},
    ):
        assert not allowed_files.is_allowed(**{"path": "run.toml", "code": CODE, **other})  # type: ignore[arg-type]


def test_the_list_of_allowed_files_survives_garbage_and_half_entries(home: Path) -> None:
    home.mkdir()
    (home / "allowed").write_bytes(b"\xff\n" + b"0" * 63)
    assert allowed_files.allow("run.toml", CODE)
    with (home / "allowed").open("ab") as file:
        file.write(b"\n" + b"0" * 12)  # half an entry
    assert allowed_files.allow("other.toml", CODE)
    with (home / "allowed").open("ab") as file:
        file.write(b"\x00\xff" * 2**17)
    for name in ("run.toml", "other.toml"):
        assert allowed_files.is_allowed(name, CODE)
    size = (home / "allowed").stat().st_size
    assert allowed_files.allow("run.toml", CODE)
    assert (home / "allowed").stat().st_size == size, "each file is listed once"


def test_the_list_keeps_only_the_last_allowed_files(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(allowed_files, "_MAX_LINES", 10)
    names = [f"{number}{'é' * 100}.toml" for number in range(38)]
    for name in names:
        assert allowed_files.allow(name, CODE)
    listed = [name for name in names if allowed_files.is_allowed(name, CODE)]
    assert listed == names[-len(listed) :]
    assert 5 <= len(listed) <= 10
    assert (home / "allowed").stat().st_size < 10 * 400


def test_files_that_are_allowed_at_once_are_all_listed(home: Path) -> None:
    del home
    names = [f"{number}.toml" for number in range(40)]
    with ThreadPoolExecutor(8) as threads:
        assert all(threads.map(lambda name: allowed_files.allow(name, CODE), names))
    assert all(allowed_files.is_allowed(name, CODE) for name in names)


@pytest.mark.usefixtures("home")
def test_signed_code_is_loaded_from_the_folder_of_the_signature_only(tmp_path: Path) -> None:
    parts = {**CODE, **part("strategy", "frenetic", likely=True)}
    signed = arguments(signature=signatures.sign(**arguments(code=named_code(parts))))
    del signed["code"]
    with pytest.raises(FreneticError, match=r"code that was in here, which is no folder now"):
        trust.require_trusted("c", CodeClaim(parts, **signed))
    assert trust.require_trusted("c", CodeClaim(parts, **signed), is_trusted=True) == tmp_path
    Path("here").mkdir()
    assert trust.require_trusted("c", CodeClaim(parts, **signed)) == Path("here")
    assert trust.require_trusted("c", CodeClaim(parts, **signed), is_trusted=True) == Path("here")
    assert trust.require_trusted("c", CodeClaim(parts, **signed), named=CODE) == tmp_path, (
        "a named part comes from the current folder"
    )
    with pytest.raises(
        FreneticError, match=r"if you do, go to where it was as that says, there, and name it"
    ):
        trust.require_trusted("c", CodeClaim(parts, **{**signed, "folder": "there"}))
    Path("theirs.py").touch()
    others: list[dict[str, object]] = [
        {"folder": "there"},
        {"sources": {}},
        {"signature": "0" * 64},
    ]
    for changes in others:
        with pytest.raises(
            FreneticError, match=r"c names the driver 'theirs\.py:Theirs', code that"
        ):
            trust.require_trusted("c", CodeClaim(parts, **{**signed, **changes}))


@pytest.mark.parametrize(
    ("parts", "named", "words"),
    [
        (part("driver", "own.py:run", args=["rm"]), {}, "--driver 'own.py:run,args=[\"rm\"]'"),
        (
            part("driver", "own.py:run", args=["rm"]),
            part("driver", "own.py:run"),
            "--driver 'own.py:run,args=[\"rm\"]'",
        ),
        (
            part("simulator", "beamng", home="/opt/b", port=25252),
            part("simulator", "beamng", port=4),
            "--simulator beamng,home=/opt/b",
        ),
        (
            {"driver": ("own:A", {}), "strategy": ("own:B", {}), "objective": ("own:c", {})},
            part("strategy", "own:B"),
            "--driver own:A --objective own:c",
        ),
        (part("generator 2", "own:G", path="/opt/g"), {}, "--generator own:G,path=/opt/g"),
    ],
)
@pytest.mark.usefixtures("home")
def test_the_refusal_names_the_code_and_the_options_that_allow_it(
    parts: Parts, named: Parts, words: str
) -> None:
    """An option that would come from the file has to be named as well."""
    kinds = [*REGISTRIES, "generator"]
    with pytest.raises(FreneticError) as refused:
        trust.require_trusted("c", CodeClaim(parts), named=named, needed=parts, optional=kinds)
    text = str(refused.value)
    assert text.startswith("c names the ")
    assert text.endswith(f"if you do, name it yourself, {words}, or add --trust")
    with pytest.raises(FreneticError, match=r"that you have not trusted: if you do, add --trust$"):
        trust.require_trusted("c", CodeClaim(parts), named=named, needed=parts, optional=())
    assert trust.require_trusted("c", CodeClaim(parts), named=named, needed=named) == Path.cwd()
    assert trust.require_trusted("c", CodeClaim(parts), needed={}) == Path.cwd()
    assert trust.require_trusted("c", CodeClaim(parts), named=parts) == Path.cwd()


@pytest.mark.usefixtures("home")
def test_a_toml_file_is_trusted_once_its_part_was_named_or_trusted() -> None:
    def is_refused(**options: Any) -> bool:
        try:
            assert trust.require_trusted("run.toml", CLAIM, is_toml=True, **options) == Path.cwd()
        except FreneticError:
            return True
        return False

    for named in (
        part("driver", "planner"),
        part("driver", "theirs.py:run"),
        part("driver", "theirs.py:Theirs", gain=3.0),
    ):
        assert not is_refused(named=named)
        assert is_refused(), "another part was named"
    assert is_refused(named=part("driver", "theirs.py:Theirs"), needed=CODE)
    assert not is_refused(named=CODE)
    assert not is_refused()
    home = signatures.user_folder()
    shutil.rmtree(home)
    assert is_refused()
    assert not is_refused(is_trusted=True)
    assert not is_refused()
    with pytest.raises(FreneticError):
        trust.require_trusted("run.toml", CLAIM)  # not as TOML


@pytest.mark.usefixtures("home")
def test_a_signature_stays_valid_after_an_edit_of_the_code() -> None:
    """A digest of a file would not cover its imports; the folder belongs to the user."""
    Path("here").mkdir()
    signature = signatures.sign(**arguments())
    Path("here", "theirs.py").write_text("GAIN = 3")
    assert signatures.is_signed(signature, **arguments())
