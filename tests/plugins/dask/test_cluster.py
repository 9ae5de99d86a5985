"""Workers of a Dask cluster, with real schedulers and workers."""

from __future__ import annotations

import gc
import logging
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import cloudpickle
import pytest
from campaigns import campaign, refused
from clusters import ONE_SEAT, SHARED, Cluster, end
from contents import contents
from distributed import Client
from driving import await_attempts, await_free, drive_one, events, write_user_driver
from events import on_result
from faulty import (
    STALLED,
    Fault,
    FaultySimulator,
    Marks,
    Straight,
    Uneven,
    await_go,
    hang,
    kill,
    raise_error,
    refuse_connection,
    roads,
    sys_exit,
)
from pids import LIMIT, is_running, until
from user_modules import own_modules

from frenetic.campaign import CampaignStore, RoadTester, Summary
from frenetic.campaign.log import CampaignLog
from frenetic.drivers import Driver
from frenetic.parts.registry import DRIVERS
from frenetic.plugins.dask import cluster as cluster_module
from frenetic.plugins.dask.cluster import ClusterWorkers
from frenetic.simulators import Simulator
from frenetic.testing import DummyDriver, DummySimulator

pytest_plugins = ["campaign_fixtures"]


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler without workers."""
    with closing(Cluster(tmp_path_factory.mktemp("bare"))) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A cluster of two workers, each with a nanny and a seat."""
    with closing(Cluster(tmp_path_factory.mktemp("cluster"))) as cluster:
        cluster.start("--nworkers", "2", *ONE_SEAT)
        yield cluster


@pytest.fixture
def cluster(two: Cluster) -> Cluster:
    """The cluster with both workers, also after a test that ended a worker."""
    with client_of(two) as client:
        client.wait_for_workers(2, timeout=LIMIT)
    return two


@contextmanager
def client_of(cluster: Cluster) -> Iterator[Client]:
    """Connect a client to the cluster."""
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


@pytest.mark.heavy
def test_a_campaign_on_a_cluster_equals_that_of_a_single_process(
    cluster: Cluster, tmp_path: Path
) -> None:
    campaign(tmp_path / "here", simulator=Uneven(), max_in_flight=16).run()
    there = campaign(
        tmp_path / "there", simulator=Uneven(), max_in_flight=16, workers=cluster.address
    )
    there.run()
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    with CampaignStore.open(tmp_path / "there") as store:
        workers = {str(test.worker) for test in store.tests()}
    assert all(name.startswith("127.0.0.1:") for name in workers - {"None"})


@pytest.mark.heavy
def test_workers_need_no_copy_of_a_users_file(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    was_there = write_user_driver(tmp_path, "placed")
    monkeypatch.chdir(tmp_path)
    with own_modules():
        driver = DRIVERS.make("placed:Mine")
        with workers_of(cluster, tmp_path, DummySimulator(), driver) as workers:
            for path in tmp_path.glob("*.py"):
                path.unlink()
            assert drive_one(workers).failure is None
    assert was_there.exists()
    assert cloudpickle.list_registry_pickle_by_value() == set()


# Faults of workers


@pytest.mark.heavy
def test_a_fault_during_a_drive_costs_an_attempt(
    cluster: Cluster, tmp_path: Path, marks: Marks
) -> None:
    faults = [
        Fault(action, marks.folder, samples, times=1)
        for action, samples in {raise_error: 8, kill: 9, sys_exit: 10}.items()
    ]
    search = campaign(
        tmp_path / "c",
        8,
        strategy=Straight(8, 9, 10),
        simulator=FaultySimulator(marks.folder, drive=faults),
        workers=cluster.address,
        drive_limit=LIMIT,
    )
    assert search.run().passed == 8
    retried = {line["test"]: line["reason"] for line in events(tmp_path / "c", "test_retried")}
    expected = {1: STALLED, 2: "killed by SIGKILL", 3: "SystemExit: 3"}
    assert retried.keys() == expected.keys()
    assert all(text in retried[number] for number, text in expected.items())
    lost = {line["test"] for line in events(tmp_path / "c", "worker_lost")}
    assert lost == {2, 3}
    until(lambda: not any(map(is_running, marks.pids())), "its simulators end")


@pytest.mark.heavy
def test_a_drive_that_takes_longer_than_its_limit_is_ended(
    cluster: Cluster, tmp_path: Path, marks: Marks
) -> None:
    """It hangs in every attempt: a limit that usual drives keep would fail on a busy machine."""
    simulator = FaultySimulator(marks.folder, drive=Fault(hang, marks.folder))
    with workers_of(cluster, tmp_path, simulator, drive_limit=0.5) as workers:
        attempt = drive_one(workers)
        assert attempt.worker_lost
        assert "took more than 0.5 s" in str(attempt.failure)
        until(lambda: not any(map(is_running, marks.pids())), "its simulator ends")


@pytest.mark.heavy
def test_a_simulator_that_does_not_start_is_an_error_in_one_line(
    cluster: Cluster, tmp_path: Path, marks: Marks
) -> None:
    simulator = FaultySimulator(marks.folder, start=Fault(refuse_connection, marks.folder))
    with (
        refused("no worker could be started: .*nobody listens on port 25252"),
        workers_of(cluster, tmp_path, simulator) as workers,
    ):
        drive_one(workers)


@pytest.mark.heavy
def test_a_driver_that_cannot_be_copied_is_refused_in_one_line(
    cluster: Cluster, tmp_path: Path
) -> None:
    driver = DummyDriver()
    driver.lock = threading.Lock()  # type: ignore[attr-defined]
    with (
        refused("cannot be sent to the workers of a cluster"),
        workers_of(cluster, tmp_path, DummySimulator(), driver),
    ):
        pass


@pytest.mark.heavy
def test_workers_may_join_and_leave(cluster: Cluster, tmp_path: Path, marks: Marks) -> None:
    """A worker may drive two roads at once; other workers take over the roads of a lost worker."""
    simulator = FaultySimulator(marks.folder, drive=Fault(await_go, marks.folder, times=4))
    with workers_of(cluster, tmp_path, simulator) as workers:
        await_free(workers, 2)
        two = ("--no-nanny", "--nthreads", "2", "--resources", "simulator=2")
        with cluster.started("--name", "guest", *two):
            await_free(workers, 4)
            for candidate in roads([8, 9, 10, 11]):
                workers.submit(candidate)
            until(lambda: len(marks.numbers("await_go")) == 4, "all drive at once")
        marks.make("go")
        attempts = await_attempts(workers, 4)
        assert all(attempt.failure is None for attempt in attempts)
        assert "guest" not in {attempt.worker for attempt in attempts}
        await_free(workers, 2)


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
    budget=Budget(time=1000.0), folder="campaign", workers={address!r},
).run()
"""


@pytest.mark.heavy
def test_simulators_end_when_their_campaign_is_killed(
    cluster: Cluster, tmp_path: Path, marks: Marks
) -> None:
    script = KILLED.format(here=str(SHARED), marks=str(marks.folder), address=cluster.address)
    process = subprocess.Popen([sys.executable, "-c", script], cwd=tmp_path)
    try:
        until(
            lambda: (
                process.poll() is not None
                or (marks.numbers("await_go") and len(marks.numbers("start")) == 2)
            ),
            "a simulator drives, the other is started",
        )
    finally:
        process.kill()
        process.wait()
    until(lambda: len(marks.numbers("end")) >= 1, "the idle simulator ends")
    marks.make("go")
    until(lambda: not any(map(is_running, marks.pids())), "the driving simulator ends")


# Missing schedulers, seats and packages


@pytest.mark.heavy
def test_a_campaign_can_be_resumed_after_its_scheduler_is_lost(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder, client_log = tmp_path / "campaign", logging.getLogger("distributed.client")
    client_log.addHandler(caplog.handler)
    with closing(Cluster(tmp_path)) as cluster:
        cluster.start("--no-nanny", *ONE_SEAT)

        def lose(progress: Summary) -> None:
            if progress.tests == 3:
                end(cluster.scheduler)

        search = campaign(folder, 20, strategy=Straight(8, 9), workers=cluster.address)
        with refused(f"the Dask scheduler {cluster.address} is lost"):
            search.run(on_event=on_result(lose))
    client_log.removeHandler(caplog.handler)
    warnings = [record for record in caplog.records if record.levelno >= logging.WARNING]
    # Our error says enough: Dask's client logs no warning.
    assert not [record for record in warnings if record.name == client_log.name]
    with CampaignStore.open(folder) as store:
        assert 3 <= store.counts().result_count < 20
    summary = campaign(folder, 20, strategy=Straight(8, 9)).resume()
    assert (summary.passed, summary.errors, summary.tests) == (20, 0, 20)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nonsense://a"])
def test_an_unreachable_scheduler_is_an_error_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_LIMIT", 0.3)
    message = (
        f"there is no Dask scheduler at {re.escape(repr(address))}.*start one with 'dask scheduler'"
    )
    with refused(message):
        campaign(tmp_path / "campaign", workers=address).run()
    assert not (tmp_path / "campaign").exists()


@pytest.mark.heavy
def test_a_cluster_without_seats_is_an_error_in_one_line(
    bare: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """First without workers, then with a worker that offers no simulator."""
    monkeypatch.setattr(cluster_module, "NO_SEATS_LIMIT", 0.2)
    for options in ((), ("--no-nanny", "--nthreads", "1")):
        with ExitStack() as stack:
            if options:
                stack.enter_context(bare.started(*options))
                stack.enter_context(client_of(bare)).wait_for_workers(1)
            workers = stack.enter_context(workers_of(bare, tmp_path, DummySimulator()))
            with refused(
                f"the Dask scheduler {bare.address} offers a simulator: start some with"
                f" 'dask worker {bare.address} --nthreads 1 --resources simulator=1'"
            ):
                await_free(workers)


def test_an_error_names_the_missing_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gc.collect()  # the end of a client of another test imports from the package
    monkeypatch.delitem(sys.modules, "frenetic.plugins.dask.cluster")
    for name in list(sys.modules):
        if name.partition(".")[0] == "distributed":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with refused(r'not installed: pip install "\.\[cluster\]"'):
        campaign(tmp_path / "campaign", workers="tcp://127.0.0.1:1").run()
