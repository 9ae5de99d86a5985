"""The spec and the budget that a campaign's database holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec import structs

from frenetic.campaign.configuration import decode_budget, driving_spec, recorded_spec
from frenetic.campaign.database import DATABASE
from frenetic.campaign.reader import SIGNATURE, SOURCES, STARTED_IN
from frenetic.campaign.store import CampaignStore
from frenetic.errors import CampaignError
from frenetic.parts.named_code import named_code
from frenetic.parts.signatures import is_signed
from frenetic.spec import Budget, Signed, Spec


def signed_spec(store: CampaignStore) -> Spec:
    """Return the spec of a campaign with its user's signature, which a fact holds.

    Raises:
        CampaignError: the configuration is damaged.
    """
    spec = recorded_spec(store.config, source=store.folder / DATABASE)
    facts = (store.fact(name) for name in (STARTED_IN, SIGNATURE))
    signed = Signed(*(fact if isinstance(fact, str) else "" for fact in facts))
    return structs.replace(spec, signed=signed)


def signed_driving(store: CampaignStore) -> Spec | None:
    """Return the spec of a campaign's drives; signed, too, if this user has signed the campaign.

    The result is None for a campaign from Python without names.

    Raises:
        CampaignError: the configuration is damaged.
    """
    driving = driving_spec(store.config, source=store.folder / DATABASE)
    if driving is None:
        return None
    spec, sources = signed_spec(store), store.fact(SOURCES)
    signed = spec.signed or Signed("", "")
    is_users = is_signed(signed.signature, named_code(spec.parts), signed.folder, sources)
    return driving.signed_in(signed.folder) if is_users else driving


def is_client_driven(config: Mapping[str, Any]) -> bool:
    """Return whether a client drives the campaign's roads, see `frenetic.campaign.ask_tell`."""
    simulator = config.get("simulator")
    return isinstance(simulator, Mapping) and str(simulator.get("class")).startswith(
        "frenetic.campaign.ask_tell:"
    )


def stored_conditions(store: CampaignStore) -> dict[str, float]:
    """Return the conditions of all drives of a campaign that its user set.

    Raises:
        CampaignError: the configuration is damaged.
    """
    spec = recorded_spec(store.config, source=store.folder / DATABASE)
    return {**spec.amounts, **store.setting.conditions}


def stored_budget(store: CampaignStore) -> Budget:
    """Return the budget with which a campaign was run or resumed last.

    Raises:
        CampaignError: the campaign holds no usable budget.
    """
    try:
        return decode_budget(store.facts.get("budget", store.config.get("budget")))
    except ValueError as error:
        raise CampaignError(
            f"{store.folder} stores no usable budget: {error}; resume it with a budget"
        ) from None
