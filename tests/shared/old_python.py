"""Find names and syntax in a source file that Python 3.9 does not have."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

# Names that Python 3.9 does not have and that this project might use.
NEW_NAMES = {
    ("enum", "StrEnum"),
    ("itertools", "pairwise"),
    *(
        ("typing", name)
        for name in (
            "Concatenate",
            "Never",
            "NotRequired",
            "ParamSpec",
            "Required",
            "Self",
            "TypeAlias",
            "TypeGuard",
            "Unpack",
            "assert_never",
            "override",
            "reveal_type",
        )
    ),
}
NEW_ARGUMENTS = {("zip", "strict"), ("dataclass", "kw_only"), ("dataclass", "slots")}


def _too_new(tree: ast.AST) -> Iterator[str]:
    """Yield what a module needs, when it is imported or run, and Python 3.9 does not have."""
    if isinstance(tree, ast.If) and "TYPE_CHECKING" in ast.unparse(tree.test):
        children: list[ast.AST] = list(tree.orelse)
    elif isinstance(tree, (ast.AnnAssign, ast.arg)):
        # `from __future__ import annotations` leaves annotations unread.
        children = [tree.value] if isinstance(tree, ast.AnnAssign) and tree.value else []
    else:
        children = list(ast.iter_child_nodes(tree))
        if isinstance(tree, ast.FunctionDef) and tree.returns:
            children.remove(tree.returns)
    match tree:
        case ast.ImportFrom(module=str(module), names=names):
            yield from (f"{module}.{a.name}" for a in names if (module, a.name) in NEW_NAMES)
        case ast.Call(func=ast.Name(id=function), keywords=keywords):
            yield from (
                f"{function}({k.arg}=)" for k in keywords if (function, k.arg) in NEW_ARGUMENTS
            )
        case ast.BinOp(op=ast.BitOr(), right=ast.Constant(value=None)):
            yield ast.unparse(tree)
    for child in children:
        yield from _too_new(child)


def too_new(source: str) -> list[str]:
    """Return the names and operators of a source text that Python 3.9 does not have.

    Raises:
        SyntaxError: Python 3.9 cannot read the text.
    """
    ast.parse(source, feature_version=(3, 9))
    return list(_too_new(ast.parse(source)))


def too_new_in(file: Path) -> list[str]:
    """Check a file as `too_new` does; assert that Python does not evaluate its annotations."""
    source = file.read_text(encoding="utf-8")
    assert "def " not in source or "from __future__ import annotations" in source
    return too_new(source)
