"""Benches of generators that crash, hang, exit or misbehave in other ways."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import sys
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_parts import Frail, Reluctant
from pids import LIMIT, descendants, until_gone

from frenetic.campaign import CampaignStore, RoadTester
from frenetic.campaign.check import check_campaign
from frenetic.drivers import Driver, Planner
from frenetic.errors import FreneticError
from frenetic.export import export_campaign
from frenetic.oracle.outcome import Outcome
from frenetic.plugins.bench import Bench, End, Entrant, RunState, RunTerms
from frenetic.plugins.bench.bench import unusual_endings
from frenetic.plugins.bench.generator import GeneratorProcess
from frenetic.plugins.bench.results import write_results
from frenetic.plugins.bench.runs import assignment
from frenetic.plugins.bench.strategy import RunEnding
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator, Simulator
from frenetic.spec import Budget
from frenetic.spec.terms import Terms
from frenetic.testing import DummyDriver

pytestmark = [pytest.mark.heavy, pytest.mark.usefixtures("new_process_server")]
GENERATORS = Path(__file__).parent / "generators"
SIMULATIONS = 10
SECONDS_PER_TEST = 36.0


def generator(spec: str, name: str = "") -> Entrant:
    """Return an entrant of the folder ``generators``."""
    return Entrant(name=name or spec.rpartition(":")[2], spec=spec, path=GENERATORS)


def bench_of(
    folder: Path,
    *entrants: Entrant,
    repeats: int = 1,
    simulator: Simulator | None = None,
    driver: Driver | None = None,
    **terms: Any,
) -> Bench:
    tester = RoadTester(simulator or EmbeddedSimulator(), driver or Planner())
    defaults = {"simulations": SIMULATIONS, "seconds_per_test": SECONDS_PER_TEST}
    return Bench(
        entrants=entrants,
        terms=RunTerms(tester, **{**defaults, **terms}),
        repeats=repeats,
        folder=folder,
    )


def run_bench(bench: Bench, workers: int = 2) -> dict[str, RunState]:
    """Run a bench; return the state of each entrant's first run."""
    ends = bench.run(workers=workers)
    return {end.run.entrant.name: end for end in ends if end.run.repeat == 1}


def results_of(folder: Path) -> list[tuple[Outcome, bytes]]:
    with CampaignStore.open(folder) as store:
        return [(test.outcome, test.candidate.curvatures.tobytes()) for test in store.tests()]


def first_messages(spec: str, folder: Path, *, log: Path) -> list[dict[str, Any] | None]:
    """Return the first two messages of a generator's process, all if it asks for no test."""
    bench = bench_of(folder, Entrant(name="it", spec=spec))
    task = assignment(bench.runs[0], bench.terms)
    with GeneratorProcess(task, folder=folder / "work", log=log) as process:
        return [process.receive(LIMIT), process.receive(LIMIT)]


def test_the_usual_repeats_suffice_for_nineteen_entrants(tmp_path: Path) -> None:
    entrants = [Entrant(name=f"random {i}", spec="random", is_strategy=True) for i in range(20)]
    assert bench_of(tmp_path, *entrants[:19]).repeats_needed == Bench.repeats
    assert bench_of(tmp_path, *entrants).repeats_needed > Bench.repeats


# Each generator ends in its own way, without an effect on the others


@pytest.fixture(scope="module")
def mixed_bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[Bench, dict[str, RunState]]:
    bench = bench_of(
        tmp_path_factory.mktemp("mixed") / "bench",
        generator("random_roads:RandomRoads"),
        *(
            generator(f"many:{name}")
            for name in ("Crashing", "Exiting", "NeverReturning", "Stubborn", "Threads", "Old2021")
        ),
        generator("odd_tests:OddTests"),
        Entrant(name="a copy", spec="helped:Helped", path=GENERATORS / "own_pipeline"),
        generator("many:Copying"),
        Entrant(
            name="AtHome",
            spec="at_home:AtHome",
            path=GENERATORS / "own_files" / "tool",
            copy=GENERATORS / "own_files",
        ),
        Entrant(name="random", spec="random", is_strategy=True),
        patience=8.0,
    )
    return bench, run_bench(bench)


@pytest.mark.parametrize("workers", [0, 1.5])
def test_an_impossible_number_of_workers_is_refused(tmp_path: Path, workers: float) -> None:
    bench = bench_of(tmp_path / "bench", Entrant(name="random", spec="random", is_strategy=True))
    with pytest.raises(ValueError, match=f"^workers is {workers}: a whole number"):
        bench.run(workers=workers)  # type: ignore[arg-type]
    assert not bench.folder.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows moves no folder that is in use")
@pytest.mark.parametrize("action", ["moved", "deleted"])
def test_a_bench_whose_folder_is_moved_or_deleted_does_not_recreate_it(
    action: str, tmp_path: Path
) -> None:
    random = Entrant(name="random", spec="random", is_strategy=True)
    bench = bench_of(tmp_path / "bench", random, repeats=3)

    def take_away(_: RunState) -> None:
        if action == "moved":
            bench.folder.rename(tmp_path / "new")
        else:
            shutil.rmtree(bench.folder)

    where = f" to {tmp_path / 'new'}" if (sys.platform, action) == ("linux", "moved") else ""
    rest = "its complete runs are there" if action == "moved" else "its runs are gone"
    words = f"{bench.folder} was {action}{where} while the bench ran: {rest}"
    with pytest.raises(FreneticError, match=re.escape(words)):
        bench.run(workers=1, on_end=take_away)
    assert not bench.folder.exists()
    if action == "moved":
        new = replace(bench, folder=tmp_path / "new")
        assert [state.ending is not None for state in new.states()] == [True, False, False]
        assert len(new.run(resume=True, workers=1)) == 2


def test_a_copy_leaves_out_git_virtual_environments_and_the_bench_itself(tmp_path: Path) -> None:
    (tmp_path / ".git").mkdir()
    (tmp_path / "venv").mkdir()
    (tmp_path / "venv" / "pyvenv.cfg").touch()
    (tmp_path / "maker.py").write_text(
        "class Maker:\n"
        "    def __init__(self, executor=None, map_size=None): pass\n"
        "    def start(self): pass\n",
        encoding="utf-8",
    )
    entrant = Entrant(name="Maker", spec="maker:Maker", copy=tmp_path)
    bench = bench_of(tmp_path / "benches" / "one", entrant)
    work = run_bench(bench)["Maker"].run.folder / "work"
    names = {child.name for child in work.iterdir()} - {"__pycache__"}  # of the copied module
    assert names == {"maker.py", "results"}


@pytest.mark.parametrize(
    ("name", "end", "detail", "simulations"),
    [
        ("RandomRoads", End.OVER, "", SIMULATIONS),
        ("Crashing", End.CRASHED, "", 3),
        ("Exiting", End.EXIT, "exit code 7", None),
        ("NeverReturning", End.HUNG, "no test for 8 s, with 288 s of its budget left", 2),
        ("Stubborn", End.OVER, "", SIMULATIONS),
        ("Threads", End.RETURNED, "", 4),
        ("Old2021", End.RETURNED, "", SIMULATIONS // 2),
        ("OddTests", None, "", None),
        ("a copy", None, "", None),
        ("Copying", End.OVER, "", SIMULATIONS),
        ("AtHome", End.RETURNED, "", 3),
        ("random", End.OVER, "", SIMULATIONS),
    ],
)
def test_the_end_of_each_generator_is_recorded(
    mixed_bench: tuple[Bench, dict[str, RunState]],
    name: str,
    end: End | None,
    detail: str,
    simulations: int | None,
) -> None:
    run_end = mixed_bench[1][name]
    assert run_end.trouble == ""
    ending = run_end.ending
    assert ending is not None
    assert end is None or ending.end is end, ending
    assert ending.end is not End.CRASHED or end is End.CRASHED, ending
    assert detail in ending.detail
    folder = run_end.run.folder
    assert check_campaign(folder).findings == ()
    with CampaignStore.open(folder) as store:
        counts, facts = store.counts(), store.facts
    assert simulations is None or counts.simulations == simulations
    assert counts.simulations > 0
    assert facts["seconds_per_test"] == SECONDS_PER_TEST
    assert facts["bench"] == {"end": str(ending.end), "detail": ending.detail}
    assert facts["interrupted"] is False


def test_malformed_tests_come_back_invalid(
    mixed_bench: tuple[Bench, dict[str, RunState]],
) -> None:
    work = mixed_bench[1]["OddTests"].run.folder / "work"
    answers = json.loads((work / "answers.json").read_text(encoding="utf-8"))
    assert [row[:2] for row in answers[:6]] == [
        *[["INVALID", "Not enough road points."]] * 2,
        ["INVALID", "The road is not long enough."],
        ["INVALID", "Two consecutive road points are the same"],
        *[["INVALID", "Wrong type"]] * 2,
    ]
    assert answers[6][0] == "PASS"
    assert answers[7:] == [["INVALID", "Wrong type", []]] * 2


SNEAKY = """
import os, signal, subprocess, sys, time
from pathlib import Path
from code_pipeline.tests_generation import RoadTestFactory

SLEEPING = [sys.executable, "-c", "import time; time.sleep(600)"]

class Sneaky:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def start(self):
        self.prepare()
        while not self.executor.is_over():
            points = [(20.0, 20.0 + 20.0 * i) for i in range(8)]
            self.executor.execute_test(RoadTestFactory.create_road_test(points))

    def prepare(self):
        pass

class Detaching(Sneaky):
    def prepare(self):
        process = subprocess.Popen(SLEEPING, start_new_session=True)
        Path("sleeping").write_text(str(process.pid))

class Starting(Sneaky):
    def prepare(self):
        process = subprocess.Popen(SLEEPING)
        Path("sleeping").write_text(str(process.pid))

class Dying(Sneaky):
    def prepare(self):
        if os.fork() == 0:
            time.sleep(600)
        os.kill(os.getpid(), signal.SIGSEGV)

class Filing(Sneaky):
    def prepare(self):
        place = Path(self.executor.result_folder)
        (place / "mine.txt").write_text("mine")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="the generators use fork and signals")
def test_processes_that_a_generator_leaves_do_not_delay_the_bench(tmp_path: Path) -> None:
    (tmp_path / "sneaky.py").write_text(SNEAKY, encoding="utf-8")
    entrants = [
        Entrant(name=name, spec=str(tmp_path / f"sneaky.py:{name}"))
        for name in ("Detaching", "Starting", "Dying", "Filing")
    ]
    ends = run_bench(bench_of(tmp_path / "bench", *entrants, patience=1e6))
    sleeping = {
        name: int((ends[name].run.folder / "work" / "sleeping").read_text())
        for name in ("Detaching", "Starting")
    }
    if sys.platform != "linux":
        os.kill(
            sleeping["Detaching"], signal.SIGKILL
        )  # its own session is out of the bench's reach
    until_gone(sleeping.values())
    endings = {name: end.ending for name, end in ends.items()}
    assert endings["Detaching"] == endings["Starting"] == endings["Filing"] == RunEnding(End.OVER)
    assert endings["Dying"] == RunEnding(End.CRASHED, "its process was killed by SIGSEGV")
    file = ends["Filing"].run.folder / "work" / "results" / "mine.txt"
    assert file.read_text() == "mine"


# Folders, results and other pipelines


def test_each_generator_works_in_its_own_folder(
    mixed_bench: tuple[Bench, dict[str, RunState]],
) -> None:
    work = {name: end.run.folder / "work" for name, end in mixed_bench[1].items()}
    # A copy of the executor works like the executor: each drive gets a folder, the latest last.
    names = (work["Copying"] / "folders.txt").read_text(encoding="utf-8").split()
    assert names == sorted(set(names))
    assert len(names) == SIMULATIONS
    # Only the copy changes, not the original.
    outcomes = (work["AtHome"] / "tool" / "outcomes.txt").read_text(encoding="utf-8")
    assert outcomes == "PASS\n" * 3
    assert not (GENERATORS / "own_files" / "tool" / "outcomes.txt").exists()
    assert "Traceback" in (work["Crashing"].parent / "generator.log").read_text()


def test_all_generators_are_compared_and_unusual_endings_reported(
    mixed_bench: tuple[Bench, dict[str, RunState]],
) -> None:
    bench, ends = mixed_bench
    endings = dict(line.split(": ", 1) for line in unusual_endings(bench.states()))
    assert endings["NeverReturning"].startswith("1 of 1 runs hung: ")
    assert endings["Crashing"].startswith("1 of 1 runs crashed: ")
    assert endings["Threads"].startswith("1 of 1 runs returned")
    assert not {"RandomRoads", "random"} & endings.keys()
    comparison = bench.comparison()
    assert comparison.notes[0].partition(": ")[0] in endings
    assert set(comparison.groups) == set(ends)
    (crashed,), (whole,) = (comparison.groups[name] for name in ("Crashing", "RandomRoads"))
    assert (crashed.is_finished, whole.is_finished) == (False, True)
    assert "NeverReturning" in write_results(bench, comparison).read_text(encoding="utf-8")


def test_a_generators_points_are_stored_unchanged(
    mixed_bench: tuple[Bench, dict[str, RunState]], tmp_path: Path
) -> None:
    folder = mixed_bench[1]["RandomRoads"].run.folder
    export_campaign(folder, "competition", tmp_path / "out")
    with (tmp_path / "out" / "experiment_description.csv").open(newline="") as file:
        (experiment,) = csv.DictReader(file)
    assert (experiment["module_name"], experiment["class_name"]) == ("random_roads", "RandomRoads")
    assert float(experiment["time_budget"]) == SIMULATIONS * SECONDS_PER_TEST
    with CampaignStore.open(folder) as store:
        for test in store.tests():
            assert test.candidate.points is not None
            document = json.loads(
                (tmp_path / "out" / f"test.{test.candidate.id:04d}.json").read_text()
            )
            assert document["road_points"] == test.candidate.points.tolist()
            if test.outcome.is_driven:
                road = Road.from_points(test.candidate.points)
                assert road.curvatures.tobytes() == test.candidate.curvatures.tobytes()
                assert test.pose == road.pose


def test_the_plug_in_and_the_strategy_get_the_same_outcomes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frenetic proposes the same random roads directly and through the pipeline's interface.

    Children follow: the pipeline does not tell the yaw rates of which some of their parents have
    the largest change.
    """
    monkeypatch.setenv("FRENETIC_COMMAND", f'"{sys.executable}" -m frenetic')
    bench = bench_of(
        tmp_path / "bench",
        Entrant(name="plug-in", spec="frenetic.plugins.competition:FreneticGenerator"),
        Entrant(name="strategy", spec="frenetic", is_strategy=True),
        simulations=20,
    )
    ends = run_bench(bench)
    outcomes = {
        name: [outcome for outcome, _ in results_of(end.run.folder) if outcome.is_driven]
        for name, end in ends.items()
    }
    assert outcomes["plug-in"][:5] == outcomes["strategy"][:5]
    assert len(outcomes["plug-in"]) == len(outcomes["strategy"]) == 20


@pytest.mark.parametrize(("variable", "threads"), [(None, "1"), ("3", "3")])
def test_libraries_of_a_generator_take_one_thread_unless_the_user_wants_more(
    variable: str | None, threads: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if variable is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", variable)
    (tmp_path / "counting.py").write_text(
        "import os\n"
        "class Counting:\n"
        "    def __init__(self, executor=None, map_size=None): pass\n"
        "    def start(self): raise ValueError(os.environ['OMP_NUM_THREADS'])\n",
        encoding="utf-8",
    )
    spec = f"{tmp_path / 'counting.py'}:Counting"
    messages = first_messages(spec, tmp_path, log=tmp_path / "log")
    assert messages[1] is not None
    assert messages[1]["detail"] == f"ValueError: {threads}"


def test_a_clone_of_the_pipeline_changes_no_road_and_no_verdict(tmp_path: Path) -> None:
    clone, of_2021 = tmp_path / "clone", tmp_path / "2021"
    for place in (clone, of_2021):
        shutil.copytree(GENERATORS / "clone", place)
        for name in ("random_roads.py", "roads.py"):
            shutil.copy(GENERATORS / name, place / "tool")
    (of_2021 / "code_pipeline/executors_2021.py").replace(of_2021 / "code_pipeline/executors.py")
    records = of_2021 / "self_driving" / "simulation_data.py"
    records.write_text(records.read_text("utf-8").replace(" oob_percentage", ""), "utf-8")
    inside = Entrant(name="inside", spec="random_roads:RandomRoads", path=clone / "tool")
    copied = replace(inside, name="copied", path=of_2021 / "tool", copy=of_2021)
    beside = replace(generator("random_roads:RandomRoads", "beside"), pipeline=of_2021)
    assert inside.own_pipeline == clone.resolve()
    lone = generator("random_roads:RandomRoads", "lone")
    assert lone.own_pipeline is None
    checking = Entrant(name="checking", spec="winding:Winding", path=clone / "tool")
    ends = run_bench(bench_of(tmp_path / "bench", inside, copied, beside, lone, checking))
    results = {name: results_of(end.run.folder) for name, end in ends.items()}
    assert results["inside"] == results["copied"] == results["beside"] == results["lone"]
    assert {end.ending for end in ends.values()} == {RunEnding(End.OVER)}
    assert len(results["lone"]) >= SIMULATIONS


def test_the_time_that_a_generator_itself_takes_is_stored(tmp_path: Path) -> None:
    (end,) = bench_of(tmp_path / "bench", generator("many:Slow"), simulations=2).run()
    with CampaignStore.open(end.run.folder) as store:
        seconds = store.facts["strategy_seconds"]
    assert isinstance(seconds, float)
    assert seconds >= 2.0


# Other budgets than simulations


def test_runs_end_by_the_kilometres_driven_and_the_clock_shows_their_share(tmp_path: Path) -> None:
    random = Entrant(name="random", spec="random", is_strategy=True)
    phases = generator("many:Phases")
    bench = bench_of(tmp_path / "bench", phases, random, simulations=None, kilometres=1.5)
    for name, state in run_bench(bench).items():
        assert state.ending == RunEnding(End.OVER)
        with CampaignStore.open(state.run.folder) as store:
            driven = np.cumsum([test.result.distance or 0.0 for test in store.tests()])
        assert driven[-2] < 1500.0 <= driven[-1]
        if name == "Phases":  # which looks at the clock, to end this phase after 20 % of the time
            phase = int((state.run.folder / "work" / "first_phase.txt").read_text("utf-8"))
            assert driven[phase - 2] < 300.0 <= driven[phase - 1]
    for runs in bench.comparison().groups.values():
        assert all(run.is_finished for run in runs)


def test_the_budget_of_a_run_becomes_virtual_time() -> None:
    def terms(**limits: Any) -> RunTerms:
        return RunTerms(RoadTester(EmbeddedSimulator(), Planner()), seconds_per_test=30.0, **limits)

    assert terms().budget == Budget(simulations=200)
    assert terms().time == 6000.0
    assert terms(simulations=10, kilometres=9.0).time == 300.0
    assert terms(simulated_time=450.0).time == 450.0
    assert terms(kilometres=20.0).time == 3000.0
    assert terms(kilometres=20.0).budget == Budget(kilometres=20.0)
    assert terms(kilometres=20.0).clock_text.startswith(
        "50:00, which passes as the budget is spent"
    )


# Mistakes and accidents


def test_a_generator_that_cannot_be_built_is_reported_before_the_first_run(tmp_path: Path) -> None:
    (tmp_path / "raising.py").write_text(
        "class Raising:\n    def __init__(self, executor=None, map_size=None):\n"
        "        raise ValueError('I will not')\n    def start(self): pass\n"
    )
    bench = bench_of(tmp_path / "bench", Entrant(name="it", spec=f"{tmp_path}/raising.py:Raising"))
    with pytest.raises(FreneticError, match=r"it cannot be built.*ValueError: I will not"):
        bench.run()
    assert not bench.folder.exists()


def test_a_resumed_bench_retries_a_failed_run(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    mark.touch()
    bench = bench_of(
        tmp_path / "bench",
        generator("random_roads:RandomRoads"),
        Entrant(name="random", spec="random", is_strategy=True),
        simulator=Reluctant(mark),
        driver=DummyDriver(),
    )
    ends = run_bench(bench)
    assert [end.ending for end in ends.values()] == [None, None]
    assert all("not today" in end.trouble for end in ends.values())
    assert [state.ending for state in bench.states()] == [None, None]
    mark.unlink()
    assert all(end.ending == RunEnding(End.OVER) for end in bench.run(resume=True))
    assert bench.run(resume=True) == []


def test_a_resumed_bench_uses_the_generators_files_with_which_it_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("here", "elsewhere"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "sneaky.py").write_text(SNEAKY, encoding="utf-8")
    (tmp_path / "elsewhere" / "sneaky.py").write_text("raise ValueError('not this one')")
    monkeypatch.chdir(tmp_path / "here")
    bench = bench_of(
        tmp_path / "bench",
        Entrant(name="file", spec="sneaky.py:Sneaky"),
        Entrant(name="module", spec="sneaky:Sneaky"),
        simulations=2,
    )
    bench.run()
    for run in bench.runs:
        (run.folder / "campaign.sqlite").unlink()  # as if the runs had not begun
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert [end.ending for end in bench.run(resume=True)] == [RunEnding(End.OVER)] * 2
    shutil.rmtree(bench.runs[0].folder)
    source = tmp_path / "here" / "sneaky.py"
    source.write_text(SNEAKY + "# changed\n", encoding="utf-8")
    with pytest.raises(FreneticError, match="the source of file is not what the bench"):
        bench.run(resume=True)
    source.unlink()
    with pytest.raises(FreneticError, match="the source of file"):
        bench.run(resume=True)
    assert not bench.runs[0].folder.exists()
    source.write_text(SNEAKY, encoding="utf-8")
    assert [end.ending for end in bench.run(resume=True)] == [RunEnding(End.OVER)]


def test_a_process_that_dies_costs_its_run_only(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    mark.touch()
    bench = bench_of(
        tmp_path / "bench",
        Entrant(name="frenetic", spec="frenetic", is_strategy=True),
        repeats=2,
        simulator=Frail(mark),
        driver=DummyDriver(),
    )
    ends = bench.run(workers=2)
    assert [end.trouble for end in ends] == ["it ended with exit code 9"] * 2
    mark.unlink()
    bench.run(resume=True)
    for run in bench.runs:
        assert len(results_of(run.folder)) >= SIMULATIONS
        assert check_campaign(run.folder).findings == ()


def test_ctrl_c_finishes_current_runs_and_starts_no_other(tmp_path: Path) -> None:
    bench = bench_of(tmp_path, Entrant(name="random", spec="random", is_strategy=True), repeats=3)
    messages: list[str] = []
    interrupts: list[bool] = []

    def ask_to_stop(_: float, words: str) -> None:
        if not messages:
            signal.raise_signal(signal.SIGINT)
        messages.append(words)

    ends = bench.run(on_progress=ask_to_stop, on_interrupt=lambda: interrupts.append(True))
    assert [(end.run.repeat, end.ending) for end in ends] == [(1, RunEnding(End.OVER))]
    assert interrupts == [True]
    assert messages[-1].startswith("runs 1 of 3, ")
    assert [state.ending is None for state in bench.states()] == [False, True, True]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends processes in another way")
def test_a_second_ctrl_c_ends_the_bench_at_once(tmp_path: Path) -> None:
    bench = bench_of(tmp_path, generator("many:NeverReturning"), repeats=2)
    family: set[int] = set()

    def insist(*_: object) -> None:
        family.update(child for run in active_children() for child in descendants(run.pid or 0))
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        bench.run(workers=2, on_progress=insist)
    assert family
    until_gone(family)
    assert [state.ending for state in bench.states()] == [None, None]


def test_a_bench_needs_an_empty_folder_or_its_own_and_the_same_terms(tmp_path: Path) -> None:
    bench = bench_of(tmp_path, Entrant(name="random", spec="random", is_strategy=True))
    (tmp_path / "mine.txt").touch()
    with pytest.raises(FreneticError, match=r"is not empty: choose another place"):
        bench.run()
    with pytest.raises(FreneticError, match="holds no bench"):
        bench.run(resume=True)
    (tmp_path / "mine.txt").unlink()
    bench.run()
    other = bench_of(
        tmp_path, Entrant(name="random", spec="random", is_strategy=True), simulations=2
    )
    with pytest.raises(FreneticError, match="holds a bench with another simulations: 10, not 2"):
        other.run(resume=True)
    tester = replace(bench.terms.tester, terms=Terms(conditions={"noise": 0.1}))
    noisy = replace(bench, terms=replace(bench.terms, tester=tester))
    with pytest.raises(FreneticError, match=r"holds a bench with another with: \{\}, not"):
        noisy.run(resume=True)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"simulations": 0}, "simulations is 0"),
        ({"kilometres": -1.0}, "kilometres is -1.0"),
        ({"simulated_time": 0.0}, "simulated_time is 0.0"),
        ({"seconds_per_test": 0.0}, "seconds_per_test is 0.0"),
        ({"patience": -1.0}, "patience is -1.0"),
        ({"stability": -1}, "stability is -1"),
    ],
)
def test_terms_out_of_range_are_refused(options: dict[str, Any], why: str) -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner())
    with pytest.raises((FreneticError, ValueError), match=why):
        RunTerms(tester, **options)


def test_a_users_strategy_takes_part_and_a_strategy_that_raises_gives_up(tmp_path: Path) -> None:
    eager = Entrant(
        name="eager", spec="bench_parts:Eager", is_strategy=True, options={"cross_num": 2}
    )
    broken = Entrant(name="broken", spec="bench_parts:Broken", is_strategy=True)
    states = run_bench(bench_of(tmp_path / "b", eager, broken))
    endings = {name: state.ending for name, state in states.items()}
    assert endings["eager"] == RunEnding(End.OVER)
    assert endings["broken"] is not None
    assert endings["broken"].end is End.GAVE_UP
    assert "the strategy raised KeyError: 'pool'" in endings["broken"].detail
    compared = bench_of(tmp_path / "b", eager, broken).comparison()
    assert [run.is_finished for run in compared.groups["broken"]] == [False]
