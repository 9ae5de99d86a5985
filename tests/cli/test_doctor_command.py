"""The command line of doctor."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]


def test_doctor_says_what_is_well_and_exits_1_on_what_is_wrong(frenetic: Frenetic) -> None:
    answer = frenetic("doctor", "--simulator", "embedded")
    assert answer.code == 0
    assert "ok    curve, Stanley: 120 m in" in answer.out
    assert answer.out.endswith("embedded: all is well\n")

    arguments = ("doctor", "--simulator", "embedded,friction=0.2")
    answer = frenetic(*arguments)
    assert answer.code == 1
    assert "WRONG curve, Stanley: Car drove out of the lane" in answer.out
    assert answer.out.endswith("embedded: 1 of the checks failed\n")
    (found,) = frenetic(*arguments, "--json").json
    assert found["health"] == "something is wrong"
    assert [one["name"] for one in found["checks"] if not one["is_ok"]] == ["curve, Stanley"]
