"""Objects that a notebook shows as HTML."""

from __future__ import annotations


class NotebookRepr:
    """Base of classes that a notebook shows as HTML.

    The first entry point of the group ``frenetic.notebook`` is a function that returns the HTML of
    an object. Without such an entry point a notebook shows the ``repr``.
    """

    def _repr_html_(self) -> str | None:
        from importlib.metadata import entry_points  # imports slowly, and only notebooks need it

        for point in entry_points(group="frenetic.notebook"):
            text: str = point.load()(self)
            return text
        return None
