"""Objects that a notebook shows with a picture."""

from __future__ import annotations


class NotebookRepr:
    """Base of classes that a notebook shows as HTML, by the function of an entry point.

    The first in the group ``frenetic.notebook`` is called with the object. Without any a notebook
    shows the ``repr``.
    """

    def _repr_html_(self) -> str | None:
        from importlib.metadata import entry_points  # takes its time, and no drive needs it

        for point in entry_points(group="frenetic.notebook"):
            text: str = point.load()(self)
            return text
        return None
