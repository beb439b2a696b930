"""What a manifest says besides its fields: what a fit chose and why, the licence, the gel, the promised rate.

Choices, licence and gel are entries of the manifest's `facts`.
"""

import re
from collections.abc import Mapping
from typing import Any, Final

from edge.core.errors import BundleMismatch
from edge.core.printable import write_count, write_most
from edge.model.manifest import Manifest, RatePromise, ThresholdEntry

__all__ = [
    "AUGMENTATION",
    "DAMAGE_FOUND",
    "GEL",
    "GIVEN",
    "LICENCE",
    "LIMIT",
    "MISSING",
    "UNPROVEN",
    "USUAL_CONTACT",
    "check_revision",
    "choice_sentence",
    "copies_of_each",
    "gel_facts",
    "is_non_commercial",
    "licence_of",
    "licence_sentence",
    "promise",
]

UNPROVEN = "not proven: "
"""So begins a warning of `fit` that says what the bundle's own evidence does not show. They are the first warnings."""

AUGMENTATION: Final = "augmentation"
"""The entry's name: `each`, the rendered copies of every nominal press that the bank learnt, and `why`; else absent."""

LIMIT: Final = "limit"
"""The entry's name: `kind`, `why`, and `found`, the share of rendered damage by kind."""

MISSING: Final = "missing_relief"
"""The entry's name: `is_checked`, `why`, `found`, the share of smoother presses, and `tap`, whose features are read."""

USUAL_CONTACT = "relief_expected"
"""The array of the bank with the mean contact of nominal presses, where missing relief is checked."""


DAMAGE_FOUND: Final = "damage_found"
"""The entry of a manifest's `facts` with how many pieces of rendered damage of each size are found."""


def choice_sentence(facts: Mapping[str, Any], name: str) -> str:
    """Say what the fit chose in this entry, and why; empty for a bundle without it."""
    entry = facts.get(name)
    choice = {LIMIT: "kind", MISSING: "is_checked"}.get(name, "why")
    if not isinstance(entry, Mapping) or not {choice, "why"} <= entry.keys():
        return ""
    if name == LIMIT:
        damage_found = facts.get(DAMAGE_FOUND)
        return "; ".join(
            filter(None, (f"{entry[choice]}: {entry['why']}", damage_found and str(damage_found)))
        )
    if name == MISSING:
        return f"{'checked' if entry[choice] else 'not checked'}: {entry['why']}"
    return str(entry["why"])


def share_found(facts: Mapping[str, Any]) -> float | None:
    """Return the share of small rendered damage that the bundle finds; None where none was rendered."""
    entry = facts.get(LIMIT)
    if not isinstance(entry, Mapping) or not isinstance(shares := entry.get("found"), Mapping):
        return None
    share = shares.get(entry.get("kind"))
    return float(share) if isinstance(share, int | float) else None


def copies_of_each(facts: Mapping[str, Any]) -> int:
    """Return the copies of every nominal press in the bundle's bank, 0 for none."""
    entry = facts.get(AUGMENTATION)
    return int(entry.get("each", 0)) if isinstance(entry, Mapping) else 0


LICENCE = "licence"
"""The key in a trunk's metadata, and in a manifest's `facts` (of a detector) or `facts.backbone` (of a trunk)."""

_NON_COMMERCIAL = re.compile(r"(?<![a-z])nc(?![a-z])|non.?commercial|research.only", re.IGNORECASE)


def licence_of(manifest: Manifest) -> str | None:
    """The licences of the bundle's weights as they were stated, None where nothing was stated."""
    backbone = manifest.facts.get("backbone")
    sources = (manifest.facts, backbone if isinstance(backbone, Mapping) else {})
    stated: list[Any] = [source.get(LICENCE) for source in sources]
    return ", ".join(dict.fromkeys(str(licence) for licence in stated if licence)) or None


def is_non_commercial(licence: str) -> bool:
    """Tell whether a licence's name says that commercial use is not allowed, such as CC-BY-NC-4.0."""
    return _NON_COMMERCIAL.search(licence) is not None


def licence_sentence(manifest: Manifest) -> str | None:
    """The licence in words, None where nothing was stated."""
    licence = licence_of(manifest)
    if licence is None:
        return None
    limit = ": not for commercial use, not for production" if is_non_commercial(licence) else ""
    return f"licence of the weights {licence}{limit}"


GEL: Final = "gel"
"""The entry's name: `gel_id`, as in the gel ledger of the station."""


def gel_facts(gel_id: str | None) -> dict[str, Any]:
    """The entry of a bundle that is made on this gel; none where the gel is not named."""
    return {} if gel_id is None else {GEL: {"gel_id": gel_id}}


def check_revision(manifest: Manifest, newest: int | None, where: str) -> None:
    """Refuse a bundle that is older than the newest one in use here; None where none had a revision.

    A signature says who made a bundle, not that it is the newest: an older one with a fault stays signed. Errors:
    BundleMismatch.
    """
    revision = manifest.revision
    if newest is None or (revision is not None and revision >= newest):
        return
    has = "no revision" if revision is None else f"revision {revision}"
    raise BundleMismatch(
        f"bundle {where} for {manifest.part}/{manifest.position} has {has}, and revision {newest} was in use here: it "
        'is older; use the newer one, or set inspection.older = "allowed" to go back on purpose'
    )


GIVEN = "given by hand"
"""The method of a threshold that no press was asked for."""


def promise(limit: ThresholdEntry) -> str:
    """Say in one or two sentences which rate of false alarms the limit promises."""
    if not limit.n:
        is_given = limit.method == GIVEN
        return f"no rate is promised: the threshold {'was given' if is_given else f'is {limit.method}'}"
    if limit.alpha_floor == 1 and limit.by_press is not None:
        return _of_known_pieces(limit, limit.by_press)
    rate = f"at most {write_most(limit.alpha)}"
    if limit.is_floored:
        floor = f"{_percent(limit.alpha_floor)} (1 in {round(1 / limit.alpha_floor)})"
        rate = f"at best {floor}, not {_percent(limit.alpha)},"
    presses, whom = write_count(limit.n, "press"), "sound presses"
    if limit.pieces == limit.n:
        presses += f", counted as {write_count(limit.n, 'piece')}"
    elif limit.pieces is not None:
        presses += f" of {write_count(limit.pieces, 'piece')}"
        whom += " of new pieces"
    whole = f"{presses}: {rate} of {whom} fail, on average over bundles"
    return f"{whole}{_of_this_bundle(limit)}"


def _of_known_pieces(limit: ThresholdEntry, press: RatePromise) -> str:
    """No piece was held out, or too few to know how others differ."""
    these = "this piece" if limit.pieces == 1 else "these pieces"
    return (
        f"{write_count(limit.n, 'press')} of {write_count(limit.pieces or 0, 'piece')}: at most "
        f"{write_most(press.rate)} of presses of {these} fail, {100 * press.confidence:.0f} % sure; "
        "of other pieces nothing is promised, their sound presses may all fail"
    )


def _of_this_bundle(limit: ThresholdEntry) -> str:
    """Bundles of older versions have a range, or nothing."""
    press, piece = limit.by_press, limit.by_piece
    if press is not None:
        presses = f"{write_most(press.rate)} of {'presses' if piece is None else 'presses of these pieces'}"
        most = presses if piece is None else f"{write_most(piece.rate)} of new pieces and {presses}"
        return f"; with this bundle at most {most}, {100 * press.confidence:.0f} % sure"
    if limit.rate_range is not None:
        low, high = map(_percent, limit.rate_range)
        return f"; of this bundle alone {low} to {high} (95 %)"
    return ""


def _percent(rate: float) -> str:
    return f"{100 * rate:.2g} %"
