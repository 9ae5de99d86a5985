"""Every command: its JSON, and its mistakes, each of which is one line and changes no file."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import pytest

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.cli import cli, main
from frenetic.drivers import Planner
from frenetic.oracle.outcome import Outcome
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator

if TYPE_CHECKING:
    from collections.abc import Callable

    from command_line import Frenetic

pytest_plugins = ["command_line"]

COUNTS: Final = (
    "tests roads simulations passed failed invalid errors dropped min_moobd kilometres"
    " simulated_seconds"
)
CALLS: Final = {
    "init keeps_its_lane.py": "class driver test",
    "run --simulations 3 --seed 1 --workers 1 --out new": (
        f"{COUNTS} folder seed seconds tests_per_second causes notes distinct_failures near_misses"
        " ended interrupted facts notice not_repeatable"
    ),
    "resume c --simulations 2 --workers 1": f"{COUNTS} folder seed distinct_failures ended",
    "show c": f"{COUNTS} folder config causes distinct_failures near_misses coverage sweep facts",
    "show c 1": "id test_outcome moobd description driven driver rules curvatures step picture",
    "report c": "report",
    "check c": f"{COUNTS} folder findings outstanding trajectories bytes",
    "export c --format competition": "folder format outcomes",
    "export c 1 --format trace,file=mcap": "folder format outcomes",
    "rerun c --top 1 --times 2": (
        "campaign folder driver simulator variations passed same missing changes matches tests"
    ),
    "rerun c --top 1 --stability": (
        "campaign folder driver simulator is_own missing stability passing_with_more_grip"
    ),
    "minimise c --max-drives 5": (
        "name test road reason match drives ending trouble conditions length length_before"
    ),
    "estimate --odd odd.toml --drives 100": "domain method rate low high drives failures",
    "margin --of delay --random-roads 2 --out m": (
        "domain driver simulator share roads demanding_roads seed drives folder margins shortfalls"
    ),
    "compare one=c two=d": "about groups measures notes order",
    "compare c --driver aggression=0.9 --fresh 2": (
        "answer verdict difference time_difference old new fresh known causes notes seed domain"
        " overall sentences quality"
    ),
    "drive bend.json": (
        "road outcome reason moobd moobd_distance max_oob_share duration distance length findings"
        " fault driver simulator"
    ),
    "drive c 1": "road outcome differs driver simulator",
    "drive --manoeuvre step,radius=200": (
        "manoeuvre options quantities speed_limit length outcome reason moobd driver conditions"
    ),
    "drive bend.json --trace bend.mcap --layouts": "trace road outcome",
    "drive --manoeuvre step --trace step.csv": "trace manoeuvre",
    "drive bend.json --compare run.csv": "road outcome compared",
    "drive bend.json --dry": "road valid message",
    "calibrate drives.jsonl --driver planner --fit braking": (
        "name driven lane_width fitted recordings validation"
    ),
    "bench --strategy random --simulations 3 --repeats 1 --workers 1 --out b": (
        "about groups measures notes order runs"
    ),
    "list": "drivers objectives conditions simulators strategies",
    "list simulators": "name target origin summary lays",
    "doctor --simulator embedded": "simulator health checks note",
}
"""A command line -> the keys of its JSON document, or of the first one in it."""

# A command line, and words of the line that refuses it.
MISTAKES: Final = [
    ("fly", "No such command 'fly'"),
    ("bench --simulations 0", "simulations"),
    ("calibrate nowhere --driver planner --fit braking", "nowhere"),
    ("report nowhere", "nowhere does not exist"),
    ("list nowhere", "nowhere"),
    ("init no-module.py", "no-module.py is no name"),
    ("init json.py", "a module named json"),
    ("init mine.py", "mine.py exists"),
    ("run --simulations 0", "'--simulations': simulations is 0: a whole number >= 1 is needed"),
    ("run --time 0", "'--time'", "more than 0 s"),
    ("run --no-such-option", "No such option"),
    ("run --driver plannr", "unknown driver 'plannr'", "did you mean 'planner'?"),
    ("run --driver no.py:Driver", "there is no file 'no.py'"),
    ("run --driver strange.py:A", "'strange.py:A'", "SystemExit: it ran"),
    ("run --driver mine.py", "mine.py names no class in the file: add it, mine.py:Class"),
    ("run --with delay=0.1 --with delay=0.2", "delay is there twice"),
    ("run --with friction=0.5 --simulator friction=0.7", "friction is there twice, in --with"),
    ("run --with steering_gian=0.9", "unknown condition 'steering_gian'; did you mean 'steering_"),
    ("run --with steering_gain=9", "steering_gain is 9: 0 to 3 is needed"),
    ("run --with speed_dropout=often", "'speed_dropout=often' is not NAME=VALUE"),
    ("rerun c --vary steering_rate=0:1", "within 0.01 to 100 rad/s is needed"),
    ("run --roads competition,length=300", "the competition's roads have no options"),
    ("run --roads rural-80,design_speed=20", "the length of rural-80 is 2000 m", "length=250 or"),
    ("run --roads urban-50 --map-size 50", "the length of urban-50 is 1000 m", "does not fit"),
    ("run --map-size 25", "map_size is 25 m, and fewer than 2 of 300 random roads are valid"),
    ("run --odd odd.toml --with friction=0.5", "friction is given, and odd draws it"),
    ("run --odd odd.toml --simulator friction=0.5", "friction is given, and odd draws it"),
    ("run --driver mine.py:Slwo", "did you mean 'Slow'?"),
    ("run --driver agression=1", "did you mean 'aggression'?"),
    ("run --driver planner,aggression", "'aggression' is not OPTION=VALUE"),
    ("run --with load=100 --simulator metadrive", "MetaDriveSimulator cannot vary load"),
    ("run --odd windy.toml --simulator metadrive", "MetaDriveSimulator cannot vary gust"),
    ("run --odd foggy.toml", "fog changes what a camera sees, and the driver has none"),
    ("run --workers nowhere", "neither a number nor the address of a Dask scheduler"),
    (f"run --workers 1{400 * '0'}", "'--workers'", "0: 1 to 1024 are allowed"),
    ("run --criteria speed_limit=0", "speed_limit is 0"),
    ("run --out c", "c already holds a campaign"),
    ("run --out ''", "an empty name"),
    ("run no.toml", "there is no file no.toml"),
    ("run c", "c is a campaign's folder: its file is c/campaign.toml"),
    ("run --criteria after-un-r79,yaw_rate=-4", "yaw_rate is -4: at least 0 is needed"),
    ("run driver.toml", "code that you have not trusted", "--driver strange.py:A, or add --trust"),
    ("run simulator.toml", "--simulator beamng,home=/opt/theirs"),
    ("resume nowhere", "nowhere does not exist"),
    ("resume c", "the budget of c is spent", "--simulations"),
    ("resume python --simulations 5", "Campaign.resume()"),
    ("show nowhere", "nowhere does not exist"),
    ("show c 99999", "99999"),
    ("show c --sort beauty", "'beauty'", "severity", "max_curvature"),
    ("show c --feature beauty=1:2", "'beauty'"),
    ("show c --feature bends=many", "'bends=many' is not NAME=LOW:HIGH"),
    ("show c --feature =1:2", "'=1:2' is not NAME=LOW:HIGH"),
    ("show c --feature ''", "'' is not NAME=LOW:HIGH or NAME"),
    ("show c --feature bends=4", "'bends=4' is not NAME=LOW:HIGH or NAME"),
    ("show c 1 --limit 3", "the ID of a test"),
    ("show c --limit 3 --follow", "--follow"),
    ("check nowhere", "nowhere does not exist"),
    ("export nowhere --format csv", "nowhere"),
    (
        "export c --format trace,file=pdf",
        "no trace is a file of the form 'pdf': choose csv or mcap",
    ),
    ("export c --format trace,files=mcap", "trace has no option 'files'; did you mean 'file'?"),
    ("export c 99999 --format trace", "c holds no test of candidate 99999"),
    ("export c 1 --format trace --outcome fail", "--outcome is for a whole campaign"),
    ("export c 1 --format trace --out file", "file cannot be written"),
    ("export c --format trace --out c", "c exists already: choose another place with --out"),
    ("export nowhere --format trace", "nowhere does not exist"),
    ("export bend.json --format trace", "'trace' is no format of a road"),
    ("doctor --simulator nowhere", "unknown simulator 'nowhere'"),
    ("doctor --simulator friction=0.2", "needs a name before"),
    ("rerun nowhere", "nowhere does not exist"),
    ("rerun c {failing} --top 2", "exclude each other"),
    ("rerun c --vary mass=1:2", "unknown condition 'mass'", "friction, wet"),
    ("rerun c --out c", "holds another campaign: choose another place with --out"),
    ("rerun c --junit no/such/a.xml", "no folder"),
    ("rerun c --junit folder", "--junit", "folder cannot be written: Is a directory"),
    (
        "rerun c --simulator frenetic.testing:DummySimulator --vary friction=0.8:1.0",
        "DummySimulator cannot vary friction",
        "leave it out",
    ),
    ("rerun c --simulator metadrive --vary start --vary load", "cannot vary load", "list simul"),
    ("rerun c --stability --times 3", "--stability has its own drives", "leave out --times"),
    ("rerun c {passed} --stability", "test {passed} is PASS: only failures are studied"),
    (
        "rerun c --stability --simulator frenetic.testing:DummySimulator",
        "DummySimulator cannot vary friction",
    ),
    ("rerun windy --simulator commonroad", "CommonRoadSimulator cannot vary friction"),
    ("rerun python", "started from Python", "--driver and --simulator"),
    ("minimise .", "holds no campaign"),
    ("minimise d", "holds no failing road"),
    ("minimise c {passed}", "test {passed} is", "only a failing road"),
    ("minimise c 1 --top 2", "--top", "exclude each other"),
    ("minimise c 1 2 --out x.json", "--out is for one road"),
    ("minimise straight.json", "only a road that fails", "PASS"),
    ("minimise bend.json 3", "bend.json is no folder", "a campaign"),
    ("minimise bend.json --out bend.json", "bend.json is the road itself"),
    ("minimise bend.json --out name.json", "cannot be written: Is a directory; choose another"),
    ("estimate", "--odd FILE or the folder of a CAMPAIGN"),
    ("estimate c", "c searched no domain"),
    ("estimate nowhere", "nowhere does not exist"),
    ("estimate windy --driver stanley", "windy is driven as before: leave out the options"),
    ("estimate --odd odd.toml --with friction=0.5", "friction is given, and odd draws it"),
    ("estimate --odd nowhere.toml", "nowhere.toml"),
    ("estimate --odd odd.toml --drives 5", "100"),
    ("margin nowhere", "nowhere does not exist"),
    ("margin c --driver stanley", "c is driven as before: leave out the options"),
    ("margin --of dealy", "unknown condition 'dealy'; did you mean 'delay'?"),
    ("margin --of delay=a", "'delay=a' is not NAME or NAME=AMOUNT, as in delay=0.5"),
    ("margin --of delay=11", "delay is 11: 0 to 10 s is needed"),
    ("margin --of delay=0", "delay 0 s is the usual amount"),
    ("margin --of gust_at", "gust_at has no usual amount"),
    ("margin --of delay --of delay=0.3", "--of delay is there twice"),
    ("margin --of load --simulator metadrive", "MetaDriveSimulator cannot vary load"),
    ("margin --of fog", "fog changes what a camera sees, and the driver has none"),
    ("margin --at-least delay", "'delay' is not NAME=AMOUNT, as in delay=0.2"),
    ("margin --at-least delay=nan", "'delay=nan' is not NAME=AMOUNT"),
    ("margin --random-roads 0", "'--random-roads'", "0 is not"),
    ("margin --of delay --plot margins.gif", "a picture's name must end with .png, .svg or .pdf"),
    ("margin --of delay --map-size 30", "none of 1000 random roads is valid on a map of 30 m"),
    ("margin --of delay --out c", "c holds another campaign: choose another place with --out"),
    ("run --odd odd.toml --strategy frenetic-2021", "searches roads alone"),
    ("compare nowhere", "nowhere is no folder"),
    ("compare c e", "1 group of campaigns", "at least two"),
    ("compare a=x-* c", "x-* matches no folder"),
    ("compare a=c b=d --out a.gif", "must end with one of .html, .png"),
    ("compare a=c b=d --out nowhere/a.html", "cannot be written"),
    ("compare c --driver planner", "both versions are the same"),
    ("compare c d --driver stanley", "d has other parts than c: driver planner: aggression is 0.3"),
    ("compare c e --driver stanley", "c and e have the same roads and conditions: leave out one"),
    ("compare c nowhere --driver stanley", "nowhere is no folder"),
    ("compare c --driver stanley --out p.png", "p.png must end with .html"),
    ("compare c --driver stanley --out nowhere/a.html", "cannot be written"),
    ("compare c --driver stanley --disturb noise", "'noise' is not NAME=AMOUNT", "nor none"),
    ("compare c --driver stanley --disturb nose=1", "unknown condition 'nose'", "noise"),
    ("compare c --driver stanley --disturb noise=-1", "noise is -1: 0 to 10 m is needed"),
    ("compare c --driver stanley --disturb noise=nan", "noise is nan"),
    ("compare c --driver stanley --disturb gust=1,gust=2", "gust is there twice"),
    ("compare c --driver stanley --disturb gust_at=9", "gust_at is drawn for each road"),
    ("compare c d --disturb gust=1", "--disturb is for a new version of a driver"),
    ("compare c d --fresh 3", "--fresh is for a new version of a driver: add --driver"),
    ("drive nowhere.json --plot no/such/p.png", "--plot", "there is no folder no/such"),
    ("drive straight.json --dry --plot p.png", "--plot draws one drive"),
    ("drive nowhere.json", "there is no file nowhere.json"),
    ("drive straight.json --trace t.txt", "t.txt is no name for a trace", ".csv or .mcap"),
    ("drive straight.json --trace no/t.csv", "--trace", "there is no folder no"),
    ("drive straight.json --dry --trace t.csv", "--trace holds one drive"),
    ("drive c 1 2 --trace t.csv", "--trace holds one drive"),
    ("drive straight.json --layouts", "add --trace FILE"),
    ("drive nonsense.json", "nonsense.json", "is not JSON"),
    ("drive c", "c is a folder", "which tests"),
    ("drive c 1 --lane -2", "--lane and --road are for OpenDRIVE"),
    ("drive c 1 2 --plot p.png", "--plot draws one drive"),
    ("drive straight.json 1", "straight.json is not a folder"),
    ("drive", "Missing argument 'CAMPAIGN|ROAD', or the option --manoeuvre"),
    ("drive --manoeuvre stepp", "unknown manoeuvre 'stepp'", "did you mean 'step'?"),
    ("drive --manoeuvre step,radius=5", "a radius of 5 m", "at least 14.3 m"),
    ("drive --manoeuvre step,radius=0", "radius is 0: a number > 0 is needed"),
    ("drive --manoeuvre step --with speed=0", "speed is 0: 1 to 500 km/h is needed"),
    ("drive --manoeuvre step,radius", "'radius' is not OPTION=VALUE"),
    ("drive --manoeuvre step --map-size 300", "--manoeuvre needs no map"),
    ("drive straight.json --manoeuvre step", "--manoeuvre has a road of its own"),
    ("drive --manoeuvre step --dry", "--manoeuvre has a road of its own"),
    ("drive --manoeuvre step,radius=100 --roads rural-80", "the road class has at least 240 m"),
    ("run --strategy sweep,least_radius=10", "least_radius is 10", "at least 14.3 m"),
]
NAMES: Final = cli.list_commands(click.Context(cli))
"""All commands, plug-ins' too."""


@pytest.fixture(scope="module")
def workplace(
    tmp_path_factory: pytest.TempPathFactory, searched: Path, prepare: Callable[..., None]
) -> Path:
    """A folder with campaigns, roads and other files, which no mistake may change."""
    folder = tmp_path_factory.mktemp("workplace")
    shutil.copytree(searched, folder / "c", ignore=shutil.ignore_patterns("failures"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        shutil.copytree("c", "e")
        calm = ("run", "--simulations", "3", "--driver", "aggression=0.3", "--seed", "1")
        prepare(*calm, "--workers", "1", "--out", "d")
        Campaign(
            strategy=RandomSearch(seed=1),
            simulator=EmbeddedSimulator(),
            driver=Planner(),
            budget=Budget(simulations=3),
            folder="python",
        ).run()
        for name in ("folder", "name.png"):
            Path(name).mkdir()
        Path("file").write_text("in the way")
        Path("nonsense.json").write_text("nonsense")
        Path("bend.json").write_text(json.dumps({"curvatures": BEND}))
        Path("straight.json").write_text(json.dumps({"curvatures": [0.0] * 12}))
        Path("mine.py").write_text("class Slow:\n    pass\n")
        Path("test_theirs.py").write_text("mine")
        Path("strange.py").write_text("raise SystemExit('it ran')\n")
        for kind in ("driver", "strategy", "objective"):
            Path(f"{kind}.toml").write_text(f"{kind} = 'strange.py:A'\n")
        Path("odd.toml").write_text(ODD)
        Path("windy.toml").write_text(WINDY)
        Path("foggy.toml").write_text(ODD + "fog = { low = 10, high = 50, chance = 0.1 }\n")
        windy = (
            "run",
            "--simulations",
            "2",
            "--odd",
            "windy.toml",
            "--seed",
            "1",
            "--out",
            "windy",
        )
        prepare(*windy, "--driver", "aggression=5", "--workers", "1")
        Path("simulator.toml").write_text("simulator = 'beamng,home=/opt/theirs'\n")
    return folder


ODD = 'roads = "urban-50,length=200"\n[conditions]\nfriction = { low = 0.2, high = 1.0 }\n'
WINDY = """
[conditions]
friction = { low = 0.1, high = 0.2 }
gust = { low = -18, high = 18, chance = 0.2 }
"""
BEND = [0.0, 0.01, 0.0, 0.0, 0.01, 0.012, -0.03, -0.036, -0.05, 0.0, 0.0, 0.0, 0.02, 0.02]
"""The default driver leaves its lane here."""


def sizes_of_files(folder: Path) -> dict[Path, int]:
    """All files with their sizes, without Python's bytecode and SQLite's auxiliary files."""
    auxiliary = {".pyc", ".sqlite-shm", ".sqlite-wal"}
    paths = (path for path in folder.rglob("*") if path.name != "__pycache__")
    return {path: path.stat().st_size for path in paths if path.suffix not in auxiliary}


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake[0][:60])
def test_a_mistake_is_refused_in_one_line_and_changes_no_file(
    frenetic: Frenetic, workplace: Path, mistake: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(workplace)
    with CampaignStore.open("c") as store:
        ids = {
            name: next(iter(store.tests(outcome))).id
            for name, outcome in (("failing", Outcome.FAIL), ("passed", Outcome.PASS))
        }
    words = [text.format(**ids) for text in mistake]
    before = sizes_of_files(workplace)
    answer = frenetic(*shlex.split(words[0]), "--json")
    assert answer.refuses(*words[1:]), answer
    assert sizes_of_files(workplace) == before


DRIVE = {
    "curvatures": [0.0] * 6,
    "pose": [0.0, 0.0, 0.0],
    "outcome": "PASS",
    "trajectory": {"time": [0, 1, 2], "x": [0, 8, 16], "y": [-2, -2, -2]},
}


def test_every_command_has_a_call_and_a_mistake_above() -> None:
    commands = {*NAMES} - {"ask-tell"}  # ask-tell answers in JSON lines
    assert {call.split()[0] for call in CALLS} == commands
    assert {mistake.split()[0] for mistake, *_ in MISTAKES} - {"fly"} == commands


@pytest.mark.parametrize(
    "call",
    [
        pytest.param(call, marks=pytest.mark.heavy) if call.startswith("calibrate") else call
        for call in CALLS
    ],
)
def test_every_command_prints_one_json_document(frenetic: Frenetic, copied: str, call: str) -> None:
    Path("bend.json").write_text(json.dumps({"curvatures": BEND}))
    Path("odd.toml").write_text(ODD)
    Path("drives.jsonl").write_text(
        "\n".join(json.dumps(DRIVE | {"curvatures": [0, i / 1000, 0, 0, 0, 0]}) for i in range(10))
    )
    Path("run.csv").write_text("time,speed\n0,5\n60,5\n")
    shutil.copytree(copied, "d")
    answer = frenetic(*shlex.split(call), "--json")
    assert answer.code in (0, 1, 3)
    document = answer.json  # raises if stdout holds more than one document
    first = document[0] if isinstance(document, list) else document
    assert set(CALLS[call].split()) <= set(first)


LISTED: Final = {
    "drivers": ["planner", "stanley", "beamng-ai"],
    "strategies": ["frenetic", "frenetic-2021", "random", "sweep"],
    "manoeuvres": ["step", "lane-offset", "constant-radius", "sine", "slalom"],
    "simulators": ["embedded"],
    "objectives": ["moobd"],
    "conditions": ["friction", "wet", "wet_at", "gust"],
}


def test_each_list_has_the_names_of_its_parts(frenetic: Frenetic) -> None:
    document, all_lists = frenetic("list", "--json").json, frenetic("list").out
    for command, names in LISTED.items():
        text = frenetic("list", command).out
        assert all(name in text and name in all_lists for name in names)
        assert frenetic("list", command, "--json").json == document[command]
        assert [entry["name"] for entry in document[command]][: len(names)] == names


def test_help_lists_all_commands(frenetic: Frenetic) -> None:
    for arguments in ((), ("--help",)):
        answer = frenetic(*arguments)
        assert answer.code == 0
        assert all(f"  {name} " in answer.out for name in NAMES)


def test_help_fits_on_a_screen(frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for command in NAMES:
        lines = frenetic(command, "--help").out.splitlines()
        assert len(lines) <= 50, command
        assert max(map(len, lines)) <= 80, command


def test_help_of_every_command_imports_no_slow_package() -> None:
    code = (
        "import sys\n"
        "from frenetic.cli import cli\n"
        f"for command in {NAMES}:\n"
        "    cli.main([command, '--help'], standalone_mode=False)\n"
        "    slow = {'numba', 'matplotlib', 'numpy', 'scipy'} & set(sys.modules)\n"
        "    assert not slow, (command, slow)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.count("Usage: ") == len(NAMES)


@pytest.mark.heavy
def test_linear_algebra_uses_one_thread_unless_the_user_sets_more(tmp_path: Path) -> None:
    (tmp_path / "road.json").write_text('{"curvatures": [0.0, 0.02, 0.0]}')
    code = (
        "from frenetic.cli import main\n"
        "try: main(['drive', 'road.json', '--dry'])\n"
        "except SystemExit: pass\n"
        "from threadpoolctl import threadpool_info\n"
        "pools = [pool for pool in threadpool_info() if pool['user_api'] == 'blas']\n"
        "import os\n"
        "print(os.environ['OPENBLAS_NUM_THREADS'], {pool['num_threads'] for pool in pools} <= {1})"
    )
    for wanted, output in (({}, "1 True"), ({"OPENBLAS_NUM_THREADS": "3"}, "3 ")):
        others = {name: text for name, text in os.environ.items() if "OPENBLAS" not in name}
        done = subprocess.check_output(
            [sys.executable, "-c", code], cwd=tmp_path, env=others | wanted, text=True
        )
        assert done.splitlines()[-1].startswith(output)


def test_a_file_that_ends_too_early_is_no_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    from frenetic.cli import list as command

    def cut_off(**_: object) -> None:
        raise EOFError("marshal data too short")  # as from a module that a full disk has cut off

    monkeypatch.setattr(command.list_parts, "callback", cut_off)
    with pytest.raises(EOFError, match="too short"):
        main(["list", "drivers"])


PRESSES_CTRL_C: Final = """
import os
import signal
import sys


class PressesCtrlC:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["PRESS_AT"]:
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)


sys.meta_path.insert(0, PressesCtrlC())
"""


@pytest.mark.parametrize("module", ["frenetic.cli", "click", "frenetic.errors", "rich.console"])
@pytest.mark.parametrize(
    "program", [("-m", "frenetic"), ("-c", "from frenetic.__main__ import main; main()")]
)
def test_ctrl_c_while_the_command_line_is_imported_ends_it_in_one_line(
    tmp_path: Path, program: tuple[str, str], module: str
) -> None:
    (tmp_path / "sitecustomize.py").write_text(PRESSES_CTRL_C)
    done = subprocess.run(
        [sys.executable, *program, "list", "drivers"],
        env=os.environ | {"PYTHONPATH": str(tmp_path), "PRESS_AT": module},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (130, "")
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("frenetic: interrupted")


def test_the_program_imports_nothing_before_it_handles_ctrl_c() -> None:
    code = (
        "import sys\n"
        "before = set(sys.modules)\n"
        "import frenetic.__main__\n"
        "print(sorted(set(sys.modules) - before))"
    )
    done = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert done.strip() == "['frenetic', 'frenetic.__main__']"


TALKS: Final = """
print("imported")

class Talks:
    def __init__(self):
        print("made")

    def reset(self, setup):
        print("reset")

    def act(self, observation):
        print("asked")
        raise ValueError

def objective(road, drive):
    print("judged")
    return 0.0
"""


ONE_BY_ONE: Final = """
import json, sys
from frenetic.cli import main

for arguments in json.loads(sys.argv[1]):
    try:
        main(arguments)
    except SystemExit as stop:
        assert stop.code in (0, 1), stop.code
    for stream in (sys.stdout, sys.stderr):
        print("-" * 20, file=stream, flush=True)
"""


@pytest.mark.heavy
def test_what_a_driver_prints_is_kept_out_of_stdout(tmp_path: Path) -> None:
    (tmp_path / "talks.py").write_text(TALKS)
    (tmp_path / "road.json").write_text(json.dumps({"curvatures": BEND}))
    run = ("run", "--simulations", "2", "--seed", "1")
    calls = [
        (*run, "--workers", "1", "--out", "one"),
        (*run, "--workers", "2", "--out", "two"),
        ("drive", "road.json"),
    ]
    talking = [(*call, "--driver", "talks.py:Talks", "--json") for call in calls]
    done = subprocess.run(
        [sys.executable, "-c", ONE_BY_ONE, json.dumps(talking)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for stream, is_right in ((done.stdout, is_a_document), (done.stderr, has_all_prints)):
        *outputs, after_last = stream.split(f"{'-' * 20}\n")
        assert [is_right(output) for output in outputs] == [True] * len(calls), stream
        assert after_last == ""


def test_what_an_objective_prints_is_kept_out_of_stdout(frenetic: Frenetic) -> None:
    Path("talks.py").write_text(TALKS)
    options = ("--simulations", "2", "--seed", "1", "--workers", "1", "--json")
    done = frenetic("run", *options, "--objective", "talks.py:objective", "--out", "three")
    assert done.json["simulations"] == 2
    assert "judged" in done.err


def is_a_document(text: str) -> bool:
    return isinstance(json.loads(text), dict)


def has_all_prints(text: str) -> bool:
    return all(words in text for words in ("imported", "made", "reset", "asked"))
