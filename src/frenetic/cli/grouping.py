"""Options with their own headline in the help."""

from __future__ import annotations

from typing import Any

import click


class GroupedOption(click.Option):
    """An option of a group.

    Args:
        group: the group's headline.
        arguments: those of `click.Option`.
    """

    def __init__(self, *arguments: Any, group: str, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.group = group


class GroupedCommand(click.Command):
    """A command whose help groups its options."""

    first_group = "Options"
    """The headline of the options that come first: of those without a group, if no other."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes all options, group by group."""
        groups: dict[str, list[tuple[str, str]]] = {self.first_group: []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                group = parameter.group if isinstance(parameter, GroupedOption) else "Options"
                groups.setdefault(group, []).append(record)
        for group, records in groups.items():
            with formatter.section(group):
                formatter.write_dl(records)
