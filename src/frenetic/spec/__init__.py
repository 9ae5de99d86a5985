"""The spec of a run: what its user says, by the same names everywhere.

A `Spec` is the entries of ``campaign.toml``. The options of `frenetic run` have their names, a
campaign's database and a failing road's file keep them, and Python takes them::

    spec = Spec.of({"driver": "planner,aggression=1.2", "with": {"delay": 0.1}, "seed": 1})
    spec = Spec.of(Spec.read("campaign.toml"), {"simulations": 50})

What a user leaves out stays out. What follows is a property: `Spec.terms`, `Spec.rules`,
`Spec.budget`. `Spec.make_strategy`, `Spec.make_driver` and `Spec.make_simulator` make its parts.

Every command's help reads this module, so slow imports are inside functions.
"""

from frenetic.spec.budget import Budget
from frenetic.spec.files import DRIVEN, SIGNED, read_entries, sign_driven, write_entries
from frenetic.spec.parts import USUAL, Part, usual_of
from frenetic.spec.run_entries import RunEntries, Signed
from frenetic.spec.spec import DRIVING, FILE, Spec
from frenetic.spec.values import COMPETITION, MAX_WORKERS, read_workers

__all__ = [
    "COMPETITION",
    "DRIVEN",
    "DRIVING",
    "FILE",
    "MAX_WORKERS",
    "SIGNED",
    "USUAL",
    "Budget",
    "Part",
    "RunEntries",
    "Signed",
    "Spec",
    "read_entries",
    "read_workers",
    "sign_driven",
    "usual_of",
    "write_entries",
]
