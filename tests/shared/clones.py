"""Editions of the small clone of the pipeline in tests/bench/generators."""

from __future__ import annotations

from pathlib import Path


def make_2021(clone: Path) -> None:
    """Gives a clone the executor and records of 2021."""
    (clone / "code_pipeline" / "executors_2021.py").replace(clone / "code_pipeline/executors.py")
    records = clone / "self_driving" / "simulation_data.py"
    records.write_text(records.read_text("utf-8").replace(" oob_percentage", ""), "utf-8")
