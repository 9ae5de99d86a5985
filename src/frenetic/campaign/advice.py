"""Commands with which a user resumes a campaign, or starts another with the same parts."""

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


def resume_command(store: CampaignStore) -> str:
    """Return the command that resumes an unfinished campaign, or a sentence if there is none.

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


def next_campaign(spec: Spec, folder: Path, *, has_drives: bool, names_parts: bool = True) -> str:
    """Return the advice to start another campaign with a campaign's parts as they are now.

    Args:
        spec: spec of the campaign.
        folder: folder of the campaign.
        has_drives: whether the campaign holds a drive without a fault of the driver. Then the new
            campaign starts from it, with another seed; otherwise it repeats the same search.
        names_parts: whether the command names the user's parts, so that it works although the
            campaign's file is no longer signed. Leave them out if the current folder is not the
            folder of the parts: there the names would mean other parts.
    """
    words = ["frenetic", "run", str(folder / SPEC_FILE)]
    words += ["--from", str(folder)] if has_drives else []
    for kind in PARTS if names_parts else ():
        part = spec.part(kind)
        if part.name is not None and (kind == "driver" or REGISTRIES[kind].is_own(part.name)):
            words += [f"--{kind}", str(part)]
    if names_parts and REGISTRIES["objective"].is_own(spec.named_objective):
        words += ["--objective", spec.named_objective]
    if not has_drives:
        return f"start it anew, with the same seed: {shlex.join(words)}"
    advice = "start a new campaign from this one"
    if spec.seed is not None:
        advice += ", with another seed so that its random roads are new"
        words += ["--seed", str(spec.seed + 1)]
    return f"{advice}: {shlex.join(words)}"


def has_judged_drive(store: CampaignStore) -> bool:
    """Return whether a campaign holds a drive that did not end by a fault of its driver."""
    tests = (test for test in store.tests() if test.outcome.is_driven)
    return any(not is_drivers(test.result.fault) for test in tests)


def new_campaign_advice(spec: Spec | None, folder: Path, parts_folder: Path) -> str:
    """Return the advice to start another campaign from a stored one, see `next_campaign`.

    Args:
        spec: spec of the campaign; None for a campaign from Python without names.
        folder: folder of the campaign.
        parts_folder: folder in which the names of the parts are found.
    """
    if spec is None:
        command = shlex.join(["frenetic", "run", "--from", str(folder)])
        return f"start a new campaign from this one: {command}"
    with CampaignStore.open(folder) as store:
        has_drives = has_judged_drive(store)
    return next_campaign(spec, folder, has_drives=has_drives, names_parts=is_here(parts_folder))
