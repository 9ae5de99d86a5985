"""Defaults and checks of a campaign's options."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any, Final

from frenetic._support.bounds import require_count
from frenetic._support.option_text import number_word
from frenetic.campaign.guarded_strategy import ObservingStrategy
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers import available_cores
from frenetic.errors import CampaignError, reason_of
from frenetic.parts.construction import options_of
from frenetic.search.strategy import Strategy, has_own
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.embedded import compile_kernels, interprets_drives, rehearse
from frenetic.simulators.simulator import Simulator
from frenetic.spec import Budget, read_workers
from frenetic.spec.terms import Terms
from frenetic.spec.values import require_worker_count

CAMPAIGNS: Final = Path("campaigns")
"""Default parent of campaigns' folders."""
MAX_IN_FLIGHT: Final = 16
"""Candidates outstanding at once if several workers drive (our choice)."""
INTERPRETED_DRIVES: Final = 50
"""Largest number of drives of a campaign for which no kernel is compiled at once (our choice): so
many drives take less time interpreted than compiling does."""
QUICK_DRIVES: Final = 1000
"""Largest number of compiled drives of a campaign for which one worker is used (our choice).

One worker makes them before several workers have started.
"""
_MOST_FOLDERS: Final = 1000
"""Number from which no further folder of the same second is looked for (our choice)."""


def new_folder(parent: Path | str = CAMPAIGNS) -> Path:
    """Return a new folder in `parent`, named after the date and time."""
    parent = Path(parent)
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    folder = parent / stamp
    for number in range(2, _MOST_FOLDERS):
        if not folder.exists():
            break
        folder = parent / f"{stamp}-{number}"
    return folder


def prepare(simulator: Simulator, *, drives_here: bool = True) -> None:
    """Let a simulator measure its `car`, if it has to be started for that.

    Args:
        simulator: simulator that is not started.
        drives_here: whether it drives on this machine, so that its modules have to be installed.

    Raises:
        CampaignError: the simulator does not start.
    """
    try:
        able = capabilities(simulator)
        if drives_here and able.missing_modules:
            with simulator:  # raises an error that says what to install
                pass
        able.prepare()
    except Exception as error:
        raise CampaignError(f"the simulator does not start: {reason_of(error)}") from error


def checked_workers(workers: int | str) -> int | str:
    """Return a number of workers, or the address of a scheduler.

    Raises:
        ValueError: the value is neither, or the number exceeds what one computer may have.
    """
    if isinstance(workers, str):
        return read_workers(workers)
    return require_worker_count(require_count("workers", workers))


def usual_workers(budget: Budget | None, max_in_flight: int | None, tester: RoadTester) -> int:
    """Return the default number of workers of a campaign.

    It is 1 for few compiled drives, otherwise the simulator's usual number, or one per core.
    """
    workers = capabilities(tester.simulator).usual_workers or available_cores()
    drives = None if budget is None else budget.simulations
    if drives is not None and drives <= QUICK_DRIVES and tester.drives_compiled:
        return 1
    return workers if max_in_flight is None else min(workers, max_in_flight)


def compile_for(budget: Budget, tester: RoadTester) -> None:
    """Compile the kernels of a campaign's drives, unless it has few, which are interpreted."""
    if budget.simulations is not None and budget.simulations <= INTERPRETED_DRIVES:
        return
    if tester.drives_compiled or not interprets_drives():
        compile_kernels()
    else:
        rehearse()


def default_max_in_flight(workers: int | str) -> int:
    """Return the default number of candidates that are outstanding at once."""
    if workers == 1:
        return 1
    return max(MAX_IN_FLIGHT, workers) if isinstance(workers, int) else MAX_IN_FLIGHT


def checked_drive_limit(drive_limit: float | None, simulator: Simulator) -> float:
    """Return the limit of a drive's wall time in s, by default the simulator's.

    Raises:
        ValueError: the limit is not positive.
    """
    if drive_limit is None:
        drive_limit = capabilities(simulator).drive_limit
    if not drive_limit > 0.0:
        raise ValueError(f"drive_limit is {drive_limit}: a positive number of seconds is needed")
    return drive_limit


def require_strategy(strategy: object, workers: int | str) -> None:
    """Check that an object is a strategy with which a campaign with these workers can search.

    Raises:
        ValueError: the object is no strategy, or observes drives of other processes.
    """
    if not isinstance(strategy, Strategy):
        raise ValueError(f"{type(strategy).__name__} is no strategy: make it a frenetic.Strategy")
    if isinstance(strategy, ObservingStrategy) and workers != 1:
        raise ValueError("the strategy observes drives: it needs one worker, in this process")


def require_warm_start(strategy: Strategy) -> None:
    """Check that a strategy can start from earlier campaigns and real roads.

    Raises:
        ValueError: the strategy has no `start_from`.
    """
    if not has_own(strategy, "start_from"):
        raise ValueError(
            f"the strategy {type(strategy).__name__} starts from no earlier campaign or real"
            " road: give none, or choose a strategy with start_from, such as frenetic"
        )


def checked_terms(terms: Terms | None, strategy: Strategy) -> Terms:
    """Return terms that agree with a strategy; by default the terms of the strategy.

    Raises:
        ValueError: terms and strategy do not agree.
    """
    strategy_terms: dict[str, Any] = {
        "road_class": strategy.road_class,
        "domain": strategy.domain,
        "map_size": (options_of(strategy) or {}).get("map_size"),
    }
    strategy_terms = {name: term for name, term in strategy_terms.items() if term is not None}
    if terms is None:
        return Terms.of_class(strategy_terms.pop("road_class", None), **strategy_terms)
    for name, strategy_term in strategy_terms.items():
        if getattr(terms, name) != strategy_term:
            text, strategy_text = (
                number_word(term) if name == "map_size" else getattr(term, "name", term)
                for term in (getattr(terms, name), strategy_term)
            )
            raise ValueError(
                f"{name} is {text}, but the strategy was made for {strategy_text}: they have to"
                " agree"
            )
    return terms
