"""The command line of doctor."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]


def test_doctor_reports_each_check_and_exits_1_if_any_fails(frenetic: Frenetic) -> None:
    answer = frenetic("doctor", "--simulator", "embedded")
    assert answer.code == 0
    assert "ok    curve, Stanley: 120 m in" in answer.out
    assert answer.out.endswith("embedded: all is well\n")

    arguments = ("doctor", "--simulator", "embedded,friction=0.2")
    answer = frenetic(*arguments)
    assert answer.code == 1
    assert "WRONG curve, Stanley: Car drove out of the lane" in answer.out
    assert answer.out.endswith("embedded: 1 of the checks failed\n")
    (document,) = frenetic(*arguments, "--json").json
    assert document["health"] == "something is wrong"
    assert [check["name"] for check in document["checks"] if not check["is_ok"]] == [
        "curve, Stanley"
    ]
