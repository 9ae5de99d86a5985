"""What a source file asks of its Python that Python 3.9 does not have."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

# What Python 3.9 does not have, as far as this project is tempted.
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
    """What a module would ask of its Python, when it is imported or run, that 3.9 does not have."""
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
    """What Python 3.9 does not have of what a source text uses.

    Raises:
        SyntaxError: Python 3.9 cannot read it.
    """
    ast.parse(source, feature_version=(3, 9))
    return list(_too_new(ast.parse(source)))


def too_new_in(file: Path) -> list[str]:
    """The same of a file, which must leave its annotations unread."""
    source = file.read_text(encoding="utf-8")
    assert "def " not in source or "from __future__ import annotations" in source
    return too_new(source)
