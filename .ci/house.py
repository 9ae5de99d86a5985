"""Check that a stranger can read the code: names, sizes and rooms. CI runs this script.

Exemptions are lines of the tables below; each line gives the reason.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final

SOURCE: Final = Path(__file__).parents[1] / "src" / "frenetic"
LOOSE: Final = {"__init__.py", "__main__.py", "errors.py"}
"""Modules that may lie beside the rooms."""
MOST_LINES: Final = 500
"""Most lines of a module."""
MOST_CODE: Final = 50
"""Most lines of code of a function, without comments and docstrings."""
MOST_PARAMETERS: Final = 7
"""Most parameters of a function, without ``self``."""
PLACEHOLDERS: Final = frozenset(
    (
        "one",
        "found",
        "seen",
        "told",
        "own",
        "given",
        "theirs",
        "made",
        "kept",
        "held",
        "what",
        "how",
    )
)
"""Names that say nothing: name the thing instead."""
RIDDLES: Final = re.compile(
    r"\b(likewise|it is none|they are wrong|see there|that of|those of|this one's|that one's)\b",
    re.I,
)
"""Words for which a reader must look elsewhere."""

OPTIONS: Final = "its parameters are a user's options, passed by keyword"
LONG_FUNCTIONS: Final = {
    "campaign/campaign.py:__init__": OPTIONS,
    "search/frenetic.py:__init__": OPTIONS,
    "search/frenetic_2021.py:__init__": OPTIONS,
    "plugins/bench/host.py:make_executor": "it makes a class around a class of the pipeline",
}
"""Module and function -> why the function may be long. A kernel may be long without an entry."""
MANY_PARAMETERS: Final = {
    "campaign/campaign.py:__init__": OPTIONS,
    "campaign/record.py:of": "columns of a stored test",
    "cli/export.py:_export_roads": "options of its command",
    "plugins/beamng/simulator.py:__init__": OPTIONS,
    "plugins/vision/neural/network.py:__init__": OPTIONS,
    "road/opendrive/writing.py:_add_cubic": "attributes of an element of OpenDRIVE",
    "road/road.py:__init__": OPTIONS,
    "search/frenetic.py:__init__": OPTIONS,
    "search/frenetic_2021.py:__init__": OPTIONS,
    "search/random_roads.py:__init__": OPTIONS,
    "search/random_search.py:__init__": OPTIONS,
    "search/sweep.py:__init__": OPTIONS,
    "simulators/drive_loop.py:run_drive": "all that a simulator gives the loop, by keyword",
    "simulators/embedded/simulator.py:__init__": OPTIONS,
    "testing/lane_test.py:keeps_lane": OPTIONS,
    "testing/lane_test.py:steers_well": OPTIONS,
}
"""Module and function -> why it may have many parameters.

Kernels and commands may have many without an entry.
"""
TRUE_NAMES: Final = {"told": "as in ask and tell: a strategy is told a result, in this order"}
"""Name -> why it says enough."""


def decorators(function: ast.FunctionDef | ast.AsyncFunctionDef) -> set[str]:
    """Return the names of a function's decorators, such as ``njit`` or ``command``."""
    calls = [
        decorator.func if isinstance(decorator, ast.Call) else decorator
        for decorator in function.decorator_list
    ]
    return {call.attr if isinstance(call, ast.Attribute) else ast.unparse(call) for call in calls}


def code_lines(node: ast.AST, text: str) -> int:
    """Return the number of lines of a function without blanks, comments and docstrings."""
    documented = {
        line
        for part in ast.walk(node)
        if isinstance(part, ast.Expr)
        and isinstance(part.value, ast.Constant)
        and isinstance(part.value.value, str)
        for line in range(part.lineno, (part.end_lineno or part.lineno) + 1)
    }
    lines = text.splitlines()
    assert isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    numbers = range(node.lineno, (node.end_lineno or node.lineno) + 1)
    return sum(
        number not in documented and not re.match(r"\s*(#|$)", lines[number - 1])
        for number in numbers
    )


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the number of a function's parameters without ``self`` or ``cls``."""
    arguments = function.args
    names = [
        argument.arg for argument in arguments.posonlyargs + arguments.args + arguments.kwonlyargs
    ]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def complaints(name: str, text: str) -> Iterator[str]:
    """Yield what is wrong with a module."""
    tree = ast.parse(text)
    if "/" not in name and name not in LOOSE:
        yield f"{name}: a module beside the rooms: move it into a room"
    length = text.count("\n")
    if length > MOST_LINES:
        yield f"{name}: {length} lines, at most {MOST_LINES}"
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        place, marks = f"{name}:{node.name}", decorators(node)
        if "njit" in marks:
            continue
        if place not in LONG_FUNCTIONS and (size := code_lines(node, text)) > MOST_CODE:
            yield f"{place}: {size} lines of code, at most {MOST_CODE}"
        takes_options = place in MANY_PARAMETERS or "command" in marks
        if not takes_options and (count := parameters(node)) > MOST_PARAMETERS:
            yield f"{place}: {count} parameters, at most {MOST_PARAMETERS}"
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        is_name = token.type == tokenize.NAME and token.string in PLACEHOLDERS
        if is_name and token.string not in TRUE_NAMES:
            yield f"{name}:{token.start[0]}: the name '{token.string}' says nothing"
    for number, line in enumerate(text.splitlines(), 1):
        if riddle := RIDDLES.search(line):
            yield f"{name}:{number}: '{riddle.group()}': repeat the noun or the sentence instead"


def main() -> int:
    """Print all complaints; return 1 if there are any."""
    homes: dict[str, list[str]] = defaultdict(list)
    lines: list[str] = []
    for path in sorted(SOURCE.rglob("*.py")):
        name = path.relative_to(SOURCE).as_posix()
        text = path.read_text(encoding="utf-8")
        lines += complaints(name, text)
        for node in ast.parse(text).body:
            if isinstance(node, ast.ClassDef):
                homes[node.name.lstrip("_")].append(name)
    for kind, names in sorted(homes.items()):
        if len(names) > 1:
            lines.append(f"class {kind} stands for two things: {', '.join(names)}")
    print(*lines, sep="\n", end="\n" if lines else "")
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())
