"""What a complete fit is made of, each measured by fits without it and by fits with it alone."""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np

from calibration.experiments.backbones.sets import PROFILE, REGION
from calibration.experiments.harness.markdown import markdown_table
from calibration.fitting.fit import FitConfig, Fitted, fit_files
from calibration.fitting.presses import preparation
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.trunks import open_trunk
from edge import registry

FREE_GEL, REGISTRATION, SURROUNDINGS, DOTS, SMOOTHING, TRUNK, PIECES = MECHANISMS = (
    "free gel",
    "registration",
    "surroundings",
    "dots filled",
    "smoothing",
    "tactile_lite0",
    "limit by piece",
)
"""What a fit can be measured without."""

USES: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
    FREE_GEL: lambda row: True,
    REGISTRATION: lambda row: bool(row["is_registered"]),
    SURROUNDINGS: lambda row: row["limit"] == "surroundings",
    DOTS: lambda row: bool(row["has_dots"]),
    SMOOTHING: lambda row: True,
    TRUNK: lambda row: row["trunk"] == "tactile_lite0",
    PIECES: lambda row: bool(row["has_pieces"]),
}
"""Whether the complete fit of a row uses it, by name."""

Variant = tuple[str, str]
"""How a fit differs from the complete one: ("without", NAME), or ("alone", NAME), "" for a fit of none of them."""
COMPLETE: Variant = ("without", "")


def list_variants(row: Mapping[str, Any]) -> list[Variant]:
    """List the fits that show what each mechanism of a complete fit gains. row: of the complete fit."""
    used = [name for name in MECHANISMS if USES[name](row)]
    return [*(("without", name) for name in used), *(("alone", name) for name in ["", *used])]


def name_parts(variant: Variant) -> Collection[str]:
    """Name the mechanisms that a fit has. Registration and surroundings need the free gel."""
    how, name = variant
    if how == "without":
        return [one for one in MECHANISMS if one != name]
    return [FREE_GEL, name] if name in (REGISTRATION, SURROUNDINGS) else [name]


def fit_with(parts: Collection[str], presses: NominalPresses, method: str, backbone: str) -> Fitted:
    """Fit as `gelgate fit` does, but for mechanisms that are not named: presses may then lie anywhere."""
    if FREE_GEL not in parts:
        unknown = {"touches": (), "guessed": (), "touched": None, "no_contact": None, "free_view": None}
        presses = replace(presses, **unknown)
    if PIECES not in parts:
        presses = replace(presses, specimens=())
    detector = registry.detector(method)
    trunk = open_trunk(
        backbone if TRUNK in parts else "tactile_resnet18", detector.taps(detector.parameters())
    )
    is_registered = FREE_GEL in parts and REGISTRATION in parts
    changes: dict[str, Any] = {} if SURROUNDINGS in parts else {"limit": "plain"}
    changes |= {} if is_registered else {"register": "never", "is_scattered": True}
    config = FitConfig(
        "part", "top", PROFILE, REGION, detector, trunk, **{"register": "auto", "augment": "auto", **changes}
    )
    with ExitStack() as left:
        for part, step in ((DOTS, "take_out_dots"), (SMOOTHING, "smooth_presses")):
            if part not in parts:  # no settings of a fit
                left.enter_context(patch.object(preparation, step, lambda presses, *_: presses))
        return fit_files(presses, config, created="2026-01-01")


def gains_tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """Compare complete fits with those without each mechanism, and fits with each alone with those of none."""
    without = {row["kind"]: row for row in rows if not row.get("without") and "alone" not in row}
    bare = {row["kind"]: row for row in rows if row.get("alone") == ""}
    tables = [
        _compare(f"with / {how}" if how == "without" else "alone / none", how, base, rows)
        for how, base in (("without", without), ("alone", bare))
    ]
    return "\n\n".join(tables)


def _compare(
    title: str, how: str, base: Mapping[str, Mapping[str, Any]], rows: Sequence[Mapping[str, Any]]
) -> str:
    """Compare fits of the same kinds: means, and where a mechanism gains least."""
    lines = []
    for name in MECHANISMS:
        changed = [row for row in rows if row.get(how) == name and "error" not in row and row["kind"] in base]
        if not changed:
            continue
        pairs = [(base[row["kind"]], row) for row in changed]
        pairs = pairs if how == "without" else [(more, less) for less, more in pairs]
        means = [
            " / ".join(f"{np.mean([row[of] for row in side]):.3f}" for side in zip(*pairs, strict=True))
            for of in ("auroc", "aupro", "reported")
        ]
        alarms = " / ".join(str(sum(row["alarms"] for row in side)) for side in zip(*pairs, strict=True))
        sound = sum(row["sound"] for row in changed)
        gain, kind = min((more["aupro"] - less["aupro"], more["kind"]) for more, less in pairs)
        lines.append([name, str(len(changed)), *means, f"{alarms} of {sound}", f"{gain:+.3f}, {kind}"])
    head = [title, "kinds", "AUROC", "AU-PRO", "reported", "alarms", "least gain of AU-PRO"]
    return markdown_table(head, lines)
