"""Run the notebook and write its outputs into it: ``python docs/make_notebook.py``.

The cells run in this process, one after the other, in a temporary folder, so neither a kernel nor a
server is needed. As in Jupyter, the outputs of a cell are the text that it prints, the value of its
last expression, and its figures. The figures are also written to docs/images, for the pages that
show them.
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
COLOURS = 64  # most colours of a figure; few keep the notebook small


def run_notebook(notebook: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Run the cells in a folder; return the notebook with their outputs."""
    working_folder = Path.cwd()
    names: dict[str, Any] = {"__name__": "__main__"}  # global names, which the cells share
    plt.switch_backend("agg")
    os.chdir(folder)
    try:
        cells: list[dict[str, Any]] = []
        number = 0
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                number += 1
                outputs = run_cell("".join(cell["source"]), names, number)
                cell = {**cell, "execution_count": number, "outputs": outputs}
            cells.append(cell)
    finally:
        os.chdir(working_folder)
        plt.close("all")
    return {**notebook, "cells": cells}


def run_cell(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    """Run a code cell; return its outputs as a notebook stores them.

    Args:
        source: code of the cell.
        names: global names of the cells; the cell adds its own.
        number: number of the cell, from 1.
    """
    body = ast.parse(source).body
    # As in Jupyter, a last expression is evaluated apart, for its value.
    last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
    value, printed = None, io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(ast.Module(body, []), f"<cell {number}>", "exec"), names)  # noqa: S102
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"<cell {number}>", "eval"), names)  # noqa: S307
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append(
            {"output_type": "stream", "name": "stdout", "text": lines(printed.getvalue())}
        )
    # A semicolon at the end hides the value.
    if value is not None and not source.rstrip().endswith(";"):
        data: dict[str, Any] = {"text/plain": lines(repr(value))}
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
    """Return the figures of an executed notebook: file name -> PNG."""
    pngs = [
        base64.b64decode(output["data"]["image/png"])
        for cell in notebook["cells"]
        for output in cell.get("outputs", ())
        if "image/png" in output.get("data", ())
    ]
    return {f"notebook-{number}.png": png for number, png in enumerate(pngs, 1)}


def lines(text: str) -> list[str]:
    """Return a text as a list of lines, as notebooks store it."""
    return text.splitlines(keepends=True)


def main() -> None:
    """Run the notebook and write its outputs and figures."""
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        executed = run_notebook(notebook, Path(folder))
    text = json.dumps(executed, indent=1, ensure_ascii=False) + "\n"
    NOTEBOOK.write_text(text, encoding="utf-8", newline="\n")
    for name, png in figures(executed).items():
        (IMAGES / name).write_bytes(png)
    sys.stdout.write(f"{NOTEBOOK}: {len(text.encode()) / 1000:.0f} kB\n")


if __name__ == "__main__":
    main()
