"""The process of a generator: its end, its log, and what the bench kills afterwards."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from pids import LIMIT

from frenetic.plugins.bench.generator import GeneratorLostError, GeneratorProcess

ASSIGNMENT = {"seed": 1}


@pytest.mark.skipif(sys.platform != "linux", reason="an interpreter that is a shell script")
def test_the_id_of_a_process_that_has_ended_stays_taken_until_its_group_is_killed(
    tmp_path: Path,
) -> None:
    interpreter = tmp_path / "python"
    interpreter.write_text("#!/bin/sh\nexit 3\n")
    interpreter.chmod(0o755)
    log = tmp_path / "log"
    with GeneratorProcess(ASSIGNMENT, folder=tmp_path, log=log, python=interpreter) as process:
        with pytest.raises(GeneratorLostError, match="ended with exit code 3"):
            process.receive(LIMIT)
        process_id = process._process.pid
        os.kill(process_id, 0)  # raises if the process is reaped
    with pytest.raises(ProcessLookupError):
        os.kill(process_id, 0)


def test_a_log_that_cannot_be_written_is_an_error_before_the_generator_starts(
    tmp_path: Path,
) -> None:
    process = GeneratorProcess(ASSIGNMENT, folder=tmp_path / "work", log=tmp_path)
    with pytest.raises(OSError, match=str(tmp_path.name)), process:
        pass


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full disk to write to")
def test_a_full_disk_does_not_break_a_generator_that_prints(tmp_path: Path) -> None:
    interpreter = tmp_path / "python"
    interpreter.write_text(
        '#!/bin/sh\nfor i in 1 2 3; do echo "line $i" >&2 || exit 1; sleep 0.2; done\necho "{}"\n'
    )
    interpreter.chmod(0o755)
    log = Path("/dev/full")
    with GeneratorProcess(ASSIGNMENT, folder=tmp_path, log=log, python=interpreter) as process:
        assert process.receive(LIMIT) == {}
