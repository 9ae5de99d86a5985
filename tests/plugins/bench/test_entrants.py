"""Entrants of a bench and their names."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.errors import FreneticError
from frenetic.plugins.bench import Entrant
from frenetic.plugins.bench.entrants import folder_names


def strategy(name: str) -> Entrant:
    return Entrant(name=name, spec="random", is_strategy=True)


@given(st.lists(st.text(min_size=1, max_size=60), min_size=1, max_size=8, unique=True))
def test_every_entrant_has_its_own_folder(names: list[str]) -> None:
    usable = [name for name in names if name.strip() and name.isprintable()]
    folders = folder_names([strategy(name) for name in usable])
    assert list(folders) == usable
    assert len({folder.lower() for folder in folders.values()}) == len(usable)
    for folder in folders.values():
        assert Path(folder).name == folder
        assert folder.strip(". ") == folder
        assert folder.isascii()


def test_a_folder_has_the_name_of_its_entrant() -> None:
    names = ["WOGAN", "Frenetic, no repeats", "wogan", "…", "bench.json"]
    folders = folder_names([strategy(name) for name in names])
    assert list(folders.values()) == [
        *("wogan", "frenetic-no-repeats", "wogan-2", "entrant", "bench-json")
    ]


def test_two_entrants_of_the_same_name_are_refused() -> None:
    with pytest.raises(FreneticError, match=r"two take part as 'one'.*another name"):
        folder_names([strategy("one"), strategy("one")])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"name": " "}, "the name ' ' cannot be used"),
        ({"name": "x" * 61}, "1 to 60 printable characters"),
        ({"name": "two\nlines"}, "printable"),
        ({"spec": "wiggly"}, "package.module:Class or path/to/file.py:Class"),
        ({"spec": "wiggly.py:"}, "package.module:Class"),
        ({"spec": ":Wiggly"}, "package.module:Class"),
        ({"spec": "a:b c"}, "package.module:Class"),
        ({"path": Path("nowhere")}, "there is no folder 'nowhere'"),
        ({"python": Path("nopython")}, "there is no interpreter 'nopython'"),
        ({"options": {"a": 1}}, "only strategies have options"),
        ({"is_strategy": True, "path": Path()}, "takes no path and no copy and"),
    ],
)
def test_unusable_names_specs_and_folders_are_refused(
    fields: dict[str, object], message: str
) -> None:
    with pytest.raises(FreneticError, match=message):
        Entrant(**{"name": "one", "spec": "module:Class", **fields})  # type: ignore[arg-type]


def test_a_file_is_searched_in_the_current_folder_and_then_in_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "one.py").touch()
    entrant = Entrant(name="one", spec="one.py:One", path=Path("elsewhere"))
    assert entrant.module == str(tmp_path.resolve() / "elsewhere" / "one.py")
    assert entrant.class_name == "One"
    (tmp_path / "one.py").touch()
    assert Entrant(name="one", spec="one.py:One").module == str(tmp_path.resolve() / "one.py")
    assert Entrant(name="one", spec="package.one:One").module == "package.one"
