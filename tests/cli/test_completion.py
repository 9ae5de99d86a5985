"""Completion in a shell, as click offers it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete

from frenetic.cli import cli, main
from frenetic.parts.registry import DRIVERS, SIMULATORS, STRATEGIES


def completions(*words: str) -> list[tuple[str, str]]:
    """Type and value of what completes the last word."""
    *before, incomplete = words
    shell = ShellComplete(cli, {}, "frenetic", "_FRENETIC_COMPLETE")
    return [(item.type, item.value) for item in shell.get_completions(before, incomplete)]


def values(*words: str) -> list[str]:
    return [value for kind, value in completions(*words) if kind == "plain"]


def test_commands_and_options_are_completed() -> None:
    assert values("re") == ["report", "rerun", "resume"]
    assert "--fail-on-failure" in values("run", "--fail")
    for name in {*cli.list_commands(click.Context(cli))} - {"ask-tell"}:
        assert "--json" in values(name, "--js"), name


def test_names_of_parts_are_completed() -> None:
    registries = {"--strategy": STRATEGIES, "--driver": DRIVERS, "--simulator": SIMULATORS}
    for option, registry in registries.items():
        names = [entry.name for entry in registry.entries()]
        assert values("run", option, "") == names
        assert values("run", option, names[0][:2]) == [
            name for name in names if name.startswith(names[0][:2])
        ]
    assert "beamng" in values("doctor", "--simulator", "b")
    assert "random" in values("bench", "--strategy", "ra")
    assert completions("run", "--driver", "my_driver.p") == [("file", "my_driver.p")]


def test_each_documented_shell_gets_its_script(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = Path(__file__).parents[2] / "docs" / "command-line.md"
    documented = re.findall(r"_FRENETIC_COMPLETE=(\w+)_source", page.read_text(encoding="utf-8"))
    assert documented == ["bash", "zsh", "fish"]
    for shell in documented[sys.platform == "win32" :]:  # click runs bash, which Windows lacks
        monkeypatch.setenv("_FRENETIC_COMPLETE", f"{shell}_source")
        with pytest.raises(SystemExit):
            main([])
        assert f"_FRENETIC_COMPLETE={shell}_complete" in capsys.readouterr().out
