"""Traces of a campaign's tests, a file for each test."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

from frenetic._support.files import replacing, require_list
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.record import file_stem
from frenetic.campaign.store import CampaignStore
from frenetic.errors import FreneticError
from frenetic.export.folders import EXPORTS, added_to, whole_folder
from frenetic.export.table_rows import open_store
from frenetic.export.trace_files import TraceForm, check_form, write_form
from frenetic.export.trace_layouts import layout_texts
from frenetic.export.traces import has_records, trace_of_test
from frenetic.oracle.outcome import Outcome, chosen_outcomes

TRACE: Final = "trace"
"""Name of the format of exports that is a trace for each test, and of its folder."""


def export_traces(
    campaign: Campaign | CampaignStore | Path | str,
    out: Path | str | None = None,
    *,
    form: str = "csv",
    tests: Iterable[int] = (),
    outcomes: Outcome | str | Iterable[Outcome | str] = (),
    on_progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a trace of each driven test into a folder, such as ``test-00037.csv``.

    `frenetic.export.write_trace` says what a file holds. Layouts for PlotJuggler and, if the files
    are MCAP, for Foxglove lie beside them. Memory does not grow with the campaign, which may be
    running: later results are left out.

    Args:
        campaign: the campaign, open or not, or its folder.
        out: the folder; by default ``exports/trace`` in the campaign's folder. For all tests it has
            to be empty or new, and is written completely or not at all.
        form: ``csv`` or ``mcap``.
        tests: ids of tests, whose files are added to the folder or replaced, each completely or not
            at all; by default all driven tests.
        outcomes: one outcome, such as ``"FAIL"``, or several: only their tests are written. Empty
            for all tests, or if ``tests`` has ids.
        on_progress: called after each test with the number of tests done and of all tests.

    Returns:
        The folder.

    Raises:
        FreneticError: the form is unknown, its extra is missing, a file cannot be written, the
            campaign is damaged, or a named test has no trajectory.
        ValueError: an outcome is unknown, or both tests and outcomes are chosen.
    """
    chosen_form = check_form(form)
    wanted = chosen_outcomes(outcomes)
    named = list(dict.fromkeys(require_list("tests", tests, "ids of tests")))
    if named and outcomes:
        raise ValueError("tests and outcomes both choose tests: leave out one of them")
    notify = on_progress or (lambda *_: None)
    with open_store(campaign) as store:
        target = store.folder / EXPORTS / TRACE if out is None else Path(out)
        if named:
            _require_trajectories(store, named)
            with added_to(target) as folder:
                _write(folder, store, named, chosen_form, notify)
            return target
        driven = [test.id for test in store.tests() if test.records and test.outcome in wanted]
        with whole_folder(target) as folder:
            _write(folder, store, driven, chosen_form, notify)
    return target


def _require_trajectories(store: CampaignStore, ids: Iterable[int]) -> None:
    """Check that named tests have trajectories, before anything is written.

    Raises:
        FreneticError: a test does not exist, or has no trajectory.
    """
    for test_id in ids:
        test = store.test(test_id)
        if not has_records(test.trajectory):
            raise FreneticError(
                f"test {test_id} is {test.outcome} and has no trajectory: there is nothing to trace"
            )


def _write(
    folder: Path,
    store: CampaignStore,
    ids: Sequence[int],
    form: TraceForm,
    notify: Callable[[int, int], None],
) -> None:
    """Write the traces of tests, one after the other, and the layouts into an existing folder.

    Raises:
        OSError: a file cannot be written.
    """
    for done, test_id in enumerate(ids, 1):
        test = store.test(test_id)
        if has_records(test.trajectory):  # a broken simulator's records may be no numbers
            write_form(trace_of_test(test), folder / f"{file_stem(test_id)}.{form}", form)
        notify(done, len(ids))
    for name, text in layout_texts(form).items():
        with replacing(folder / name) as partial:
            partial.write_text(text, encoding="utf-8")
