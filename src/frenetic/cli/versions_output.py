"""What the command `compare` prints of two versions of a driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from frenetic.cli import echo
from frenetic.cli.console import print_table, shell

if TYPE_CHECKING:
    from frenetic.analysis.quality_comparison import QualityComparison
    from frenetic.rerun.back_to_back import BackToBack
    from frenetic.rerun.versions_by_class import VersionsByClass
    from frenetic.spec import Spec


def print_versions(result: BackToBack | VersionsByClass, specs: tuple[Spec, Spec]) -> None:
    """Print which driver is better, and the numbers from which that follows.

    Args:
        result: comparison on roads of one class, or of several.
        specs: specs of the old and the new version.
    """
    from frenetic.parts.records import innermost, short_version
    from frenetic.rerun.versions_by_class import VersionsByClass

    classes = result.classes if isinstance(result, VersionsByClass) else {"": result}
    for sentence in result.sentences:
        echo(sentence)
    records = (result.old, result.new)
    for version, spec, record in zip(("old", "new"), specs, records, strict=True):
        echo(f"{version}: {shell(str(spec.part('driver')))} ({short_version(innermost(record))})")
    for name, of_class in classes.items():
        if of_class.domain is not None:
            echo(f"{name or 'domain'}: {of_class.domain.as_text()}")
    _print_roads(classes)
    for name, of_class in classes.items():
        if of_class.quality is not None:
            _print_quality(name, of_class.quality)
    if result.causes:
        print_table(
            ("what the driver does", ">old fails", ">new fails"),
            [(cause, *failures) for cause, failures in result.causes.items()],
            title="On all these roads",
        )
    for note in result.notes:
        echo(f"Note: {note}")


def _print_roads(classes: Mapping[str, BackToBack]) -> None:
    """Print on how many roads each version fails, and how many changed.

    Args:
        classes: road class in words -> comparison; an empty text for the only class.
    """
    from frenetic.rerun.stability import Change

    road_sets = {
        f"{name}, {short}" if name else f"{short} roads": roads
        for name, result in classes.items()
        for short, roads in (("fresh", result.fresh), ("old's failing", result.known))
        if roads.pairs
    }
    print_table(
        ("", ">judged", ">old fails", ">new fails", *(f">{change}" for change in Change)),
        [
            (name, len(roads.judged), *roads.failing, *(roads.changes[change] for change in Change))
            for name, roads in road_sets.items()
        ],
    )


def _print_quality(name: str, quality: QualityComparison) -> None:
    """Print the differences in quality that are shown, each where it is largest.

    Args:
        name: road class in words, of which it is also said that no difference is shown; empty for
            the only class.
        quality: comparison where both pass.
    """
    from frenetic.analysis.quality_text import difference_row

    if shown := quality.shown:
        print_table(
            ("", "with", ">roads", ">old", ">new", ">difference (95 %)", ""),
            [
                (title, difference.conditions, str(difference.roads), *values)
                for difference in shown
                for title, *values in [difference_row(difference)]
            ],
            title=f"Quality on {name}, on roads that both pass"
            if name
            else "Quality, on roads that both pass",
        )
    elif name:
        echo(f"Quality on {name}: {quality.sentence}")
