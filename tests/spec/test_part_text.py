"""Texts of recorded parts for people."""

from __future__ import annotations

from pathlib import Path

import pytest
import sample_programs

from frenetic.drivers import CommandDriver
from frenetic.spec.part_record import describe
from frenetic.spec.part_text import part_text


@pytest.mark.parametrize(
    ("deadline", "text"), [(5.0, "command:{}"), (0.5, 'command,program="{}",deadline=0.5')]
)
def test_a_default_of_a_part_that_needs_an_option_is_left_out(
    tmp_path: Path, deadline: float, text: str
) -> None:
    command = sample_programs.driver(tmp_path)
    driver = CommandDriver(command, deadline=deadline)
    assert part_text(describe(driver)).replace('"', "") == text.format(command).replace('"', "")
