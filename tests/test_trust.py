"""Code that a file names is run only if the user names it, or has run that very source before."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

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
    config["spec"] |= {"simulator": "beamng,home=/opt/theirs"}
    shutil.rmtree("c")
    CampaignStore.create("c", config).close()
    refused = frenetic(*(DRIVING | OTHERS)[command]())
    assert refused.refuses("names the simulator 'beamng'")
    assert "--simulator beamng,home=/opt/theirs" in refused.err


def is_trusted(kind: str, name: str, **options: object) -> bool:
    spec = Spec.of({kind: str(Part(name, options))})
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


# Signatures, the list and the border, not yet asked by the commands

CODE: Final[trust.Parts] = {"driver": ("theirs.py:Theirs", {"gain": 2.0})}
SOURCES: Final = {"theirs.py": "import near", "near.py": "GAIN = 1"}


def part(kind: str, name: str, **options: object) -> trust.Parts:
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
def test_built_in_and_installed_parts_with_plain_options_name_no_code(parts: trust.Parts) -> None:
    assert trust.named_code(parts) == {}
    assert trust.require_trusted("c", parts) == Path.cwd()
    assert trust.sign(trust.named_code(parts), ".") == ""


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
    assert trust.named_code(parts) == parts


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
    code = trust.named_code(part(kind, name, **options, speed=3, mode="fast"))
    expected = options if kind != "generator" else {**options, "speed": 3, "mode": "fast"}
    assert code == {kind: (name, expected)}


def another(**changes: object) -> dict[str, Any]:
    """Arguments of `trust.sign`, one of which is another than those of `signed`."""
    return {"code": CODE, "folder": "here", "sources": SOURCES, **changes}


@pytest.mark.usefixtures("home")
def test_a_signature_is_for_all_that_names_code_and_its_folder_and_sources() -> None:
    signature = trust.sign(**another())
    assert signature
    assert trust.is_signed(signature, **another())
    assert trust.is_signed(signature, **another(folder=Path("here").absolute()))
    read: Any = json.loads(json.dumps(another()))
    assert trust.is_signed(signature, **read), "as a file holds it"
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
        assert not trust.is_signed(signature, **another(**changes)), changes
    for other in (None, 7, "", "é", "\ud800", signature.upper(), signature[:-1], [signature]):
        assert not trust.is_signed(other, **another()), other


def test_another_user_has_another_key(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    signature = trust.sign(**another())
    monkeypatch.setenv(trust.VARIABLE, f"{home} of another")
    assert not trust.is_signed(signature, **another())
    assert not Path(f"{home} of another").exists(), "who reads makes no key"
    assert trust.sign(**another()) != signature
    assert not trust.is_signed(signature, **another())


def test_a_link_that_leads_elsewhere_is_another_folder(tmp_path: Path, home: Path) -> None:
    del home
    for name in ("mine", "theirs"):
        Path(name).mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "mine")
    signature = trust.sign(**another(folder=link))
    assert trust.is_signed(signature, **another(folder=link))
    link.unlink()
    link.symlink_to(tmp_path / "theirs")
    assert not trust.is_signed(signature, **another(folder=link))


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such modes")
@pytest.mark.parametrize("has_links", [True, False])
def test_the_key_is_readable_by_its_user_alone(
    home: Path, has_links: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = os.umask(0)
    try:
        if not has_links:
            monkeypatch.setattr(os, "link", refuse)
        assert trust.sign(**another())
        trust.allow("run.toml", CODE)
    finally:
        os.umask(before)
    assert sorted(file.name for file in home.iterdir()) == ["allowed", "key"]
    assert [file.stat().st_mode & 0o777 for file in home.iterdir()] == [0o600, 0o600]
    assert home.stat().st_mode & 0o777 == 0o700


def refuse(*_: object) -> None:
    raise OSError("not on this file system")


@pytest.mark.parametrize("has_links", [True, False])
def test_a_process_that_is_second_takes_the_key_of_the_first(
    home: Path, has_links: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    signatures = []
    with monkeypatch.context() as patch:
        if not has_links:
            patch.setattr(os, "link", refuse)
        random = secrets.token_hex

        def token(size: int) -> str:
            """Another process makes the key at the last moment."""
            patch.setattr(secrets, "token_hex", random)
            signatures.append(trust.sign(**another()))
            return random(size)

        patch.setattr(secrets, "token_hex", token)
        signatures.append(trust.sign(**another()))
    assert signatures == [trust.sign(**another())] * 2
    assert [file.name for file in home.iterdir()] == ["key"]


def test_processes_that_begin_at_once_have_one_key(home: Path) -> None:
    code = (
        "import sys; from frenetic import trust; print(trust.folder()); sys.stdin.read();"
        " print(trust.sign({'driver': ('own.py:Own', {})}, '.'))"
    )
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen([sys.executable, "-c", code], **pipes) for _ in range(3)]
    for process in processes:
        assert process.stdout is not None
        process.stdout.readline()  # it has imported
    with ThreadPoolExecutor() as threads:
        lines = {out for out, _ in threads.map(subprocess.Popen.communicate, processes)}
    assert lines == {f"{trust.sign({'driver': ('own.py:Own', {})}, '.')}\n"}
    assert [file.name for file in home.iterdir()] == ["key"]


@pytest.mark.parametrize("damage", ["a file", "garbage", "too short", "a folder", "no home"])
def test_without_a_key_all_goes_on_unsigned_and_one_line_says_what_to_do(
    damage: str, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if damage == "a file":
        home.touch()
    elif damage == "no home":
        monkeypatch.setattr(trust, "folder", lambda: Path("~nobody-of-this-name").expanduser())
    else:
        home.mkdir()
        text = {"garbage": b"\xff\x00", "too short": b"00" * 31}.get(damage)
        (home / "key").mkdir() if text is None else (home / "key").write_bytes(text)
    assert trust.sign(**another()) is None
    assert not trust.is_signed("00" * 32, **another())
    assert trust.VARIABLE in trust.unsigned_text()
    assert "\n" not in trust.unsigned_text()
    with pytest.raises(FreneticError, match="code that you have not trusted"):
        trust.require_trusted("c", CODE)
    assert trust.require_trusted("c", CODE, is_trusted=True) == Path.cwd()


@pytest.mark.usefixtures("home")
def test_an_allowed_file_is_asked_again_when_what_names_code_changes() -> None:
    Path("there").mkdir()
    assert not trust.is_allowed("run.toml", CODE)
    assert trust.allow("run.toml", CODE)
    assert trust.is_allowed(Path("run.toml").absolute(), CODE)
    for other in (
        {"path": "other.toml"},
        {"code": part("driver", "theirs.py:run", gain=2.0)},
        {"code": part("driver", "theirs.py:Theirs", gain=3.0)},
        {"folder": "there"},
    ):
        assert not trust.is_allowed(**{"path": "run.toml", "code": CODE, **other})  # type: ignore[arg-type]


def test_the_list_survives_garbage_and_interrupted_processes(home: Path) -> None:
    home.mkdir()
    (home / "allowed").write_bytes(b"\xff\n" + b"0" * 63)
    assert trust.allow("run.toml", CODE)
    with (home / "allowed").open("ab") as file:
        file.write(b"\n" + b"0" * 12)  # half an entry
    assert trust.allow("other.toml", CODE)
    with (home / "allowed").open("ab") as file:
        file.write(b"\x00\xff" * 2**17)
    for name in ("run.toml", "other.toml"):
        assert trust.is_allowed(name, CODE)
    size = (home / "allowed").stat().st_size
    assert trust.allow("run.toml", CODE)
    assert (home / "allowed").stat().st_size == size, "it is there once"


def test_the_list_holds_the_last_files_only(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trust, "_MOST_LISTED", 10)
    names = [f"{number}{'é' * 100}.toml" for number in range(38)]
    for name in names:
        assert trust.allow(name, CODE)
    listed = [name for name in names if trust.is_allowed(name, CODE)]
    assert listed == names[-len(listed) :]
    assert 5 <= len(listed) <= 10
    assert (home / "allowed").stat().st_size < 10 * 400


def test_processes_that_allow_at_once_lose_nothing(home: Path) -> None:
    del home
    names = [f"{number}.toml" for number in range(40)]
    with ThreadPoolExecutor(8) as threads:
        assert all(threads.map(lambda name: trust.allow(name, CODE), names))
    assert all(trust.is_allowed(name, CODE) for name in names)


@pytest.mark.usefixtures("home")
def test_signed_code_is_loaded_from_the_folder_of_the_signature_only(tmp_path: Path) -> None:
    parts = {**CODE, **part("strategy", "frenetic", likely=True)}
    signed = another(signature=trust.sign(**another(code=trust.named_code(parts))))
    del signed["code"]
    assert trust.require_trusted("c", parts, **signed) == Path("here")
    assert trust.require_trusted("c", parts, **signed, is_trusted=True) == Path("here")
    assert trust.require_trusted("c", parts, **signed, named=CODE) == tmp_path, "where it is named"
    with pytest.raises(FreneticError, match=r"not found here: go to the folder .* started, there"):
        trust.require_trusted("c", parts, **{**signed, "folder": "there"})
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
            trust.require_trusted("c", parts, **{**signed, **changes})


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
def test_one_line_says_what_is_named_and_what_to_do(
    parts: trust.Parts, named: trust.Parts, words: str
) -> None:
    """An option that is taken over from the file is asked for, too."""
    kinds = [*trust.REGISTRIES, "generator"]
    with pytest.raises(FreneticError) as refused:
        trust.require_trusted("c", parts, named=named, made=parts, optional=kinds)
    text = str(refused.value)
    assert text.startswith("c names the ")
    assert text.endswith(f"if you do, name it yourself, {words}, or add --trust")
    with pytest.raises(FreneticError, match=r"that you have not trusted: if you do, add --trust$"):
        trust.require_trusted("c", parts, named=named, made=parts, optional=())
    assert trust.require_trusted("c", parts, named=named, made=named) == Path.cwd()
    assert trust.require_trusted("c", parts, made={}) == Path.cwd()
    assert trust.require_trusted("c", parts, named=parts) == Path.cwd()


@pytest.mark.usefixtures("home")
def test_a_file_of_a_person_runs_unasked_once_its_part_was_named_or_trusted() -> None:
    def is_refused(**more: Any) -> bool:
        try:
            assert trust.require_trusted("run.toml", CODE, is_toml=True, **more) == Path.cwd()
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
    assert is_refused(named=part("driver", "theirs.py:Theirs"), made=CODE)
    assert not is_refused(named=CODE)
    assert not is_refused()
    home = trust.folder()
    shutil.rmtree(home)
    assert is_refused()
    assert not is_refused(is_trusted=True)
    assert not is_refused()
    with pytest.raises(FreneticError):
        trust.require_trusted("run.toml", CODE)  # which is no TOML


@pytest.mark.usefixtures("home")
def test_a_signature_outlives_an_edit_of_the_code_that_it_names() -> None:
    """A digest of a file would not bind what it imports; the folder is the user's own."""
    Path("here").mkdir()
    signature = trust.sign(**another())
    Path("here", "theirs.py").write_text("GAIN = 3")
    assert trust.is_signed(signature, **another())
