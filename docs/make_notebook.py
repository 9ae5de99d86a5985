"""Runs the notebook and writes its outputs into it: ``python docs/make_notebook.py``.

The cells run here, one after the other, in a folder of their own. What Jupyter would show is kept:
what a cell prints, its last value, and its figures. So neither a kernel nor a server is needed.
The figures are written to docs/images, too, for the pages that show them.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from frenetic.report.style import encode_figure

NOTEBOOK = Path(__file__).parent / "notebook.ipynb"
IMAGES = Path(__file__).parent / "images"
COLOURS = 64  # of a picture, which keeps it small


def run_notebook(notebook: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The notebook with the outputs of its cells, run in a folder."""
    here, names = Path.cwd(), {"__name__": "__main__"}
    plt.switch_backend("agg")
    os.chdir(folder)
    try:
        cells = []
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                number = 1 + sum("outputs" in one for one in cells)
                outputs = run_cell("".join(cell["source"]), names, number)
                cell = {**cell, "execution_count": number, "outputs": outputs}
            cells.append(cell)
    finally:
        os.chdir(here)
        plt.close("all")
    return {**notebook, "cells": cells}


def run_cell(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    """The outputs of a cell."""
    body = ast.parse(source).body
    last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
    value, written = None, io.StringIO()
    with contextlib.redirect_stdout(written):
        exec(compile(ast.Module(body, []), f"<cell {number}>", "exec"), names)  # noqa: S102
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"<cell {number}>", "eval"), names)  # noqa: S307
    outputs: list[dict[str, Any]] = []
    if written.getvalue():
        outputs.append(
            {"output_type": "stream", "name": "stdout", "text": lines(written.getvalue())}
        )
    if value is not None and not source.rstrip().endswith(";"):
        data = {"text/plain": lines(repr(value))}
        if hasattr(value, "_repr_html_"):
            data["text/html"] = lines(value._repr_html_())
        outputs.append(
            {
                "output_type": "execute_result",
                "execution_count": number,
                "data": data,
                "metadata": {},
            }
        )
    for figure in map(plt.figure, plt.get_fignums()):
        png = base64.b64encode(encode_figure(figure, "png", colours=COLOURS)).decode()
        data = {"image/png": png, "text/plain": [repr(figure)]}
        outputs.append({"output_type": "display_data", "data": data, "metadata": {}})
        plt.close(figure)
    return outputs


def figures(notebook: dict[str, Any]) -> dict[str, bytes]:
    """The figures of an executed notebook, PNG, by the names of their files."""
    found = [
        base64.b64decode(output["data"]["image/png"])
        for cell in notebook["cells"]
        for output in cell.get("outputs", ())
        if "image/png" in output.get("data", ())
    ]
    return {f"notebook-{number}.png": png for number, png in enumerate(found, 1)}


def lines(text: str) -> list[str]:
    """A text as notebooks keep it."""
    return text.splitlines(keepends=True)


def main() -> None:
    """Runs the notebook where it lies."""
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        done = run_notebook(notebook, Path(folder))
    text = json.dumps(done, indent=1, ensure_ascii=False) + "\n"
    NOTEBOOK.write_text(text, encoding="utf-8", newline="\n")
    for name, png in figures(done).items():
        (IMAGES / name).write_bytes(png)
    sys.stdout.write(f"{NOTEBOOK}: {len(text.encode()) / 1000:.0f} kB\n")


if __name__ == "__main__":
    main()
