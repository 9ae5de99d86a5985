"""Advice how to resume a campaign, or to start a new campaign with the same parts."""

from __future__ import annotations

import shlex
from pathlib import Path

from frenetic.campaign.configuration import SPEC, owner_of
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.stored_spec import is_client_driven
from frenetic.oracle.verdict import is_drivers
from frenetic.parts.named_code import REGISTRIES
from frenetic.parts.trust import is_here
from frenetic.spec import SPEC_FILE, Spec
from frenetic.spec.parts import PARTS


def how_to_resume(store: CampaignStore) -> str:
    """Return how to resume an unfinished campaign: a command, or advice if no command can.

    The command names no budget: the stored budget applies.
    """
    config, folder = store.config, store.folder
    if owner := owner_of(config):
        return owner.command(folder)
    if is_client_driven(config):
        return shlex.join(["frenetic", "ask-tell", "--out", str(folder)])
    if config.get(SPEC) is None:
        return "from Python, where it was started: Campaign.resume()"
    return shlex.join(["frenetic", "resume", str(folder)])


def new_campaign_advice(
    spec: Spec, folder: Path, *, starts_from_drives: bool, names_parts: bool = True
) -> str:
    """Return the advice to start a new campaign with a campaign's parts as they are now.

    Args:
        spec: spec of the campaign.
        folder: folder of the campaign.
        starts_from_drives: whether the new campaign starts from the campaign's drives, with another
            seed; otherwise it repeats the same search. See `has_drive_without_fault`.
        names_parts: whether the command names the driver, and those other parts that are the
            user's. A part that the command names itself needs no signature, see
            `frenetic.parts.trust`; after an edit of the user's code, the campaign's signature no
            longer holds. Leave the names out if the current folder is not the folder of the parts:
            there the names would mean other parts.
    """
    words = ["frenetic", "run", str(folder / SPEC_FILE)]
    words += ["--from", str(folder)] if starts_from_drives else []
    words += _options_of_parts(spec) if names_parts else []
    if not starts_from_drives:
        return f"start it anew, with the same seed: {shlex.join(words)}"
    advice = "start a new campaign from this one"
    if spec.seed is not None:
        advice += ", with another seed so that its random roads are new"
        words += ["--seed", str(spec.seed + 1)]
    return f"{advice}: {shlex.join(words)}"


def _options_of_parts(spec: Spec) -> list[str]:
    """Return the words of a command that name the driver and those parts that are the user's.

    A built-in driver is named, too: an option may be a file of the user's, such as a network.
    """
    words = []
    for kind in PARTS:
        part = spec.part(kind)
        if part.name is not None and (kind == "driver" or REGISTRIES[kind].is_own(part.name)):
            words += [f"--{kind}", str(part)]
    if REGISTRIES["objective"].is_own(spec.named_objective):
        words += ["--objective", spec.named_objective]
    return words


def has_drive_without_fault(store: CampaignStore) -> bool:
    """Return whether a campaign holds a judged drive that no fault of its driver ended."""
    tests = (test for test in store.tests() if test.outcome.is_driven)
    return any(not is_drivers(test.result.fault) for test in tests)


def stored_campaign_advice(spec: Spec | None, folder: Path, parts_folder: Path) -> str:
    """Return the advice to start a new campaign, after a look into the stored campaign.

    Args:
        spec: spec of the campaign; None for a campaign that Python code started with objects
            instead of names of parts.
        folder: folder of the campaign.
        parts_folder: folder in which the names of the parts are found.
    """
    if spec is None:
        command = shlex.join(["frenetic", "run", "--from", str(folder)])
        return f"start a new campaign from this one: {command}"
    with CampaignStore.open(folder) as store:
        starts_from_drives = has_drive_without_fault(store)
    return new_campaign_advice(
        spec, folder, starts_from_drives=starts_from_drives, names_parts=is_here(parts_folder)
    )
