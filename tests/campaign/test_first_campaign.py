"""The first campaign on a machine, whose kernels are not on disk."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from contents import contents

from frenetic import Planner
from frenetic.campaign import Budget, RoadTester, defaults
from frenetic.campaign.defaults import INTERPRETED_DRIVES, compile_for
from frenetic.simulators import EmbeddedSimulator

FEW = INTERPRETED_DRIVES


@pytest.mark.parametrize(
    ("budget", "compiles"),
    [
        (Budget(simulations=FEW), False),
        (Budget(simulations=FEW, time=60.0), False),
        (Budget(simulations=FEW + 1), True),
        (Budget(time=60.0), True),
    ],
    ids=str,
)
def test_kernels_are_compiled_for_many_drives(
    monkeypatch: pytest.MonkeyPatch, budget: Budget, compiles: bool
) -> None:
    calls: list[bool] = []
    monkeypatch.setattr(defaults, "compile_kernels", lambda: calls.append(True))
    compile_for(budget, RoadTester(EmbeddedSimulator(), Planner()))
    assert bool(calls) is compiles


@pytest.mark.heavy
@pytest.mark.parametrize("strategy", ["random", "frenetic", "frenetic-2021"])
def test_a_first_campaign_has_the_same_bytes(tmp_path: Path, strategy: str) -> None:
    command = [sys.executable, "-m", "frenetic", "run", "--strategy", strategy, "--seed", "1"]
    command += ["--simulations", str(FEW // 2), "--out"]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    subprocess.run([*command, str(tmp_path / "first")], env=environment, check=True)
    subprocess.run([*command, str(tmp_path / "later")], check=True)
    assert contents(tmp_path / "first") == contents(tmp_path / "later")
