"""The spec of a run: what its user says, by the same names everywhere.

A `Spec` holds the entries of ``campaign.toml``. The options of `frenetic run` have the same names,
a campaign's database and a failing road's file hold the same entries, and Python takes them::

    spec = Spec.of({"driver": "planner,aggression=1.2", "with": {"delay": 0.1}, "seed": 1})
    spec = Spec.of(Spec.read("campaign.toml"), {"simulations": 50})

A spec holds only what its user sets; defaults are filled in where values are used, as in
`Spec.terms`, `Spec.rules` and `Spec.part`. Its classes build on each other:

- `RunEntries`: the entries, each with its type, bounds and help
- `RunSettings`: what follows from the entries
- `RunCode`: the code that they name, with signature and folders
- `Spec`: reading, merging, and making strategy, driver and simulator

Every command's help reads this module, so slow imports are inside functions.
"""

from frenetic.spec.budget import Budget
from frenetic.spec.files import DRIVEN, SIGNED, read_entries, sign_driven, write_entries
from frenetic.spec.parts import USUAL, Part, simulator_defaults
from frenetic.spec.run_code import RunCode
from frenetic.spec.run_entries import RunEntries, Signed
from frenetic.spec.run_settings import RunSettings
from frenetic.spec.spec import DRIVING_ENTRIES, SPEC_FILE, Spec
from frenetic.spec.values import COMPETITION, MAX_WORKERS, read_workers

__all__ = [
    "COMPETITION",
    "DRIVEN",
    "DRIVING_ENTRIES",
    "MAX_WORKERS",
    "SIGNED",
    "SPEC_FILE",
    "USUAL",
    "Budget",
    "Part",
    "RunCode",
    "RunEntries",
    "RunSettings",
    "Signed",
    "Spec",
    "read_entries",
    "read_workers",
    "sign_driven",
    "simulator_defaults",
    "write_entries",
]
