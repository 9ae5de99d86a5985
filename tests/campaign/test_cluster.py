"""Workers of a Dask cluster: real schedulers and workers, in processes of their own."""

from __future__ import annotations

import logging
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path

import cloudpickle
import pytest
from campaigns import campaign, refused
from clusters import HERE, ONE_SEAT, Cluster, end
from contents import contents
from distributed import Client
from driving import (
    ProcessesContract,
    WorkersOf,
    await_attempts,
    await_free,
    drive_all,
    drive_one,
    events,
    write_mine,
)
from events import on_result
from faulty import (
    Fault,
    FaultySimulator,
    Marks,
    Straight,
    Uneven,
    await_go,
    hang,
    roads,
    straight,
)
from pids import LIMIT, is_running, until
from user_modules import own_modules

from frenetic.campaign import CampaignStore, RoadTester, Summary
from frenetic.campaign.log import CampaignLog
from frenetic.campaign.workers import cluster as cluster_module
from frenetic.campaign.workers.cluster import ClusterWorkers
from frenetic.drivers import Driver
from frenetic.simulators import Simulator
from frenetic.spec import driver_of
from frenetic.testing import DummyDriver, DummySimulator

pytest_plugins = ["campaign_fixtures"]


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler without workers."""
    with closing(Cluster(tmp_path_factory.mktemp("bare"))) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Two workers, each with a nanny and a seat."""
    with closing(Cluster(tmp_path_factory.mktemp("cluster"))) as cluster:
        cluster.start("--nworkers", "2", *ONE_SEAT)
        yield cluster


@pytest.fixture
def cluster(two: Cluster) -> Cluster:
    """Both workers are there, also after a test that has ended one."""
    with client_of(two) as client:
        client.wait_for_workers(2, timeout=LIMIT)
    return two


@contextmanager
def client_of(cluster: Cluster) -> Iterator[Client]:
    """Somebody who does things with the cluster."""
    with Client(cluster.address, set_as_default=False) as client:
        yield client


@contextmanager
def workers_of(
    cluster: Cluster,
    folder: Path,
    simulator: Simulator,
    driver: Driver | None = None,
    drive_limit: float = LIMIT,
) -> Iterator[ClusterWorkers]:
    tester = RoadTester(simulator, driver or DummyDriver())
    with (
        CampaignLog(folder) as log,
        ClusterWorkers(tester, cluster.address, drive_limit=drive_limit, log=log) as workers,
    ):
        yield workers


class TestClusterWorkers(ProcessesContract):
    @pytest.fixture
    def workers_of(self, cluster: Cluster, tmp_path: Path) -> WorkersOf:
        return partial(workers_of, cluster, tmp_path)


# What comes of a campaign


def test_an_ordered_campaign_is_the_one_of_a_single_process(
    cluster: Cluster, tmp_path: Path
) -> None:
    campaign(tmp_path / "here", simulator=Uneven(), lookahead=16).run()
    there = campaign(tmp_path / "there", simulator=Uneven(), lookahead=16, cluster=cluster.address)
    there.run()
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    with CampaignStore.open(tmp_path / "there") as store:
        workers = {str(test.attempt.worker) for test in store.tests() if test.attempt}
    assert all(name.startswith("127.0.0.1:") for name in workers - {"None"})


def test_workers_need_no_copy_of_a_users_file(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    was_there = write_mine(tmp_path, "placed")
    monkeypatch.chdir(tmp_path)
    with own_modules():
        driver = driver_of("placed:Mine", {}, {})
        with workers_of(cluster, tmp_path, DummySimulator(), driver) as workers:
            for path in tmp_path.glob("*.py"):
                path.unlink()
            assert drive_one(workers).failure is None
    assert was_there.exists()
    assert cloudpickle.list_registry_pickle_by_value() == set()


# What goes wrong with workers


def test_a_worker_that_hangs_is_started_again_by_its_nanny(
    cluster: Cluster, tmp_path: Path, marks: Marks
) -> None:
    simulator = FaultySimulator(marks.folder, drive=Fault(hang, marks.folder, times=1))
    with workers_of(cluster, tmp_path, simulator, drive_limit=0.5) as workers:
        await_free(workers, 2)
        before = marks.pids()
        attempt = drive_one(workers)
        assert re.search("was lost: its drive took more than 0.5 s", str(attempt.failure))
        await_free(workers, 2)
        assert len(marks.pids()) == 3
        assert sum(is_running(pid) for pid in before) == 1
    lost = [(line["worker"], line.get("test")) for line in events(tmp_path, "worker_lost")]
    assert (attempt.worker, 1) in lost


def test_a_worker_that_hangs_without_a_nanny_is_left_alone(
    bare: Cluster, tmp_path: Path, marks: Marks, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "NO_SEATS_LIMIT", 0.2)
    simulator = FaultySimulator(marks.folder, drive=Fault(hang, marks.folder, times=1))
    with bare.started("--name", "mortal", "--no-nanny", *ONE_SEAT) as process:
        with client_of(bare) as client:
            client.wait_for_workers(1)
        with (
            refused(r"mortal: its drive took more than 0.5 s"),
            workers_of(bare, tmp_path, simulator, drive_limit=0.5) as workers,
        ):
            assert drive_one(workers).worker_lost
            assert process.poll() is None
            await_free(workers)


def test_workers_may_come_and_leave(cluster: Cluster, tmp_path: Path, marks: Marks) -> None:
    """Also one that drives two roads at once; what it drives when it is to leave is finished."""
    two = ("--no-nanny", "--nthreads", "2", "--resources", "simulator=2")
    simulator = FaultySimulator(marks.folder, drive=Fault(await_go, marks.folder, times=4))
    with workers_of(cluster, tmp_path, simulator) as workers, client_of(cluster) as client:
        await_free(workers, 2)
        with cluster.started("--name", "guest", *two):
            await_free(workers, 4)
            for candidate in roads([8, 9, 10, 11]):
                workers.submit(candidate)
            until(lambda: len(marks.numbers("await_go")) == 4, "all drive at once")
            (guest,) = [
                address
                for address, info in client.scheduler_info()["workers"].items()
                if info["name"] == "guest"
            ]
            retiring = threading.Thread(target=client.retire_workers, args=([guest],))
            retiring.start()
            marks.make("go")
            attempts = await_attempts(workers, 4)
            assert all(attempt.failure is None for attempt in attempts)
            assert {"guest seat 1", "guest seat 2"} < {attempt.worker for attempt in attempts}
            until(lambda: not workers.wait(0.1) and workers.free == 2, "it has left")
            retiring.join()
            until(lambda: len(marks.numbers("end")) == 2, "its simulators end")
        assert len(drive_all(workers, [8, 9, 10])) == 3


# Several campaigns


def test_another_campaign_waits_until_the_seats_are_left(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "TAKEN_INTERVAL", 0.1)
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    with ExitStack() as stack:
        others = stack.enter_context(workers_of(cluster, first, DummySimulator()))
        await_free(others, 2)
        with monkeypatch.context() as impatient:
            impatient.setattr(cluster_module, "NO_SEATS_LIMIT", 0.3)
            with (
                refused("it drives for another campaign"),
                workers_of(cluster, second, DummySimulator(), drive_limit=0.3) as workers,
            ):
                await_free(workers)
        with workers_of(cluster, second, DummySimulator()) as workers:
            assert not workers.wait(1.0)
            assert not workers.free
            stack.close()
            await_free(workers, 2)


# How they end


def test_what_runs_is_finished_at_the_end(cluster: Cluster, tmp_path: Path, marks: Marks) -> None:
    simulator = FaultySimulator(marks.folder, drive=Fault(await_go, marks.folder, times=1))
    with workers_of(cluster, tmp_path, simulator) as workers:
        await_free(workers, 2)
        workers.submit(straight(1))
        until(lambda: len(marks.numbers("await_go")) == 1, "it drives")
        marks.make("go")
    assert len(marks.numbers("end")) == 2


KILLED = """
import sys
from pathlib import Path
sys.path.insert(0, {here!r})
from faulty import Fault, FaultySimulator, Straight, await_go
from frenetic import Budget, Campaign
from frenetic.testing import DummyDriver
marks = Path({marks!r})
once = Fault(await_go, marks, times=1)
Campaign(
    strategy=Straight(8, 9), simulator=FaultySimulator(marks, drive=once), driver=DummyDriver(),
    budget=Budget(time=1000.0), folder="campaign", cluster={address!r},
).run()
"""


def test_simulators_end_when_their_campaign_is_killed(
    cluster: Cluster, tmp_path: Path, marks: Marks
) -> None:
    script = KILLED.format(here=str(HERE), marks=str(marks.folder), address=cluster.address)
    process = subprocess.Popen([sys.executable, "-c", script], cwd=tmp_path)
    try:
        until(
            lambda: (
                process.poll() is not None
                or (marks.numbers("await_go") and len(marks.numbers("start")) == 2)
            ),
            "one drives, the other is started",
        )
    finally:
        process.kill()
        process.wait()
    assert len(marks.numbers("start")) == 2
    until(lambda: len(marks.numbers("end")) >= 1, "the one between two drives ends")
    marks.make("go")
    until(lambda: marks.numbers("end") == marks.numbers("start"), "the other ends")


# What is missing


def test_a_cluster_that_loses_its_scheduler(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder, theirs = tmp_path / "campaign", logging.getLogger("distributed.client")
    theirs.addHandler(caplog.handler)
    with closing(Cluster(tmp_path)) as cluster:
        cluster.start("--no-nanny", *ONE_SEAT)

        def lose(progress: Summary) -> None:
            if progress.tests == 3:
                end(cluster.scheduler)

        search = campaign(folder, 20, strategy=Straight(8, 9), cluster=cluster.address)
        with refused(f"the Dask scheduler {cluster.address} is lost"):
            search.run(on_event=on_result(lose))
    theirs.removeHandler(caplog.handler)
    said = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert not [record for record in said if record.name == theirs.name]  # beside what we say
    with CampaignStore.open(folder) as store:
        assert 3 <= store.counts().told < 20
    summary = campaign(folder, 20, strategy=Straight(8, 9)).resume()
    assert (summary.passed, summary.errors, summary.tests) == (20, 0, 20)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nonsense://a", ""])
def test_an_unreachable_scheduler_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_LIMIT", 0.3)
    why = (
        f"there is no Dask scheduler at {re.escape(repr(address))}.*start one with 'dask scheduler'"
    )
    with refused(why):
        campaign(tmp_path / "campaign", cluster=address).run()
    assert not (tmp_path / "campaign").exists()


def test_a_cluster_without_seats_is_one_line(
    bare: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """First without workers, then with one that offers nothing, then with one of another time."""
    monkeypatch.setattr(cluster_module, "NO_SEATS_LIMIT", 0.2)

    def complaint() -> str:
        with refused() as caught, workers_of(bare, tmp_path, DummySimulator()) as workers:
            await_free(workers)
        return str(caught.value)

    how = f"start some with 'dask worker {bare.address} --nthreads 1 --resources simulator=1'"
    nobody = f"no worker of the Dask scheduler {bare.address} offers a simulator: {how}"
    assert complaint() == nobody
    with bare.started("--no-nanny", "--nthreads", "1"), client_of(bare) as client:
        client.wait_for_workers(1)
        assert complaint() == nobody
        other = tmp_path / "other" / "frenetic_roads-9.9.dist-info"
        other.mkdir(parents=True)
        (other / "METADATA").write_text("Metadata-Version: 2.1\nName: frenetic-roads\nVersion: 9.9")
        with bare.started("--name", "old", "--no-nanny", *ONE_SEAT, path=other.parent):
            client.wait_for_workers(2)
            assert "can be used: old: it has Frenetic 9.9 and Python" in (said := complaint())
            assert f"this campaign Frenetic {version('frenetic-roads')} and Python" in said


def test_a_missing_extra_says_what_brings_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "frenetic.campaign.workers.cluster")
    for name in list(sys.modules):
        if name.partition(".")[0] == "distributed":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with refused(r'not installed: pip install "\.\[cluster\]"'):
        campaign(tmp_path / "campaign", cluster="tcp://127.0.0.1:1").run()
