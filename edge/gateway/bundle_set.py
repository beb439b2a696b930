"""The bundles of a station, open and ready to score, by position of a part. Those with one backbone share its trunk.

A shadow is scored beside the bundle of its position, and decides nothing.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Final

from edge.core.errors import BundleMismatch, ConfigError
from edge.core.part_position import PartPosition, find_named, find_part
from edge.model.bundle import Bundle
from edge.model.inspector import Inspector

__all__ = ["BundleSet", "OpenBundle", "part_of"]

# A score is the highest value of its map within this share: some heads compute the two apart.
_SAME: Final = 1e-4


def part_of(bundle: Bundle) -> PartPosition:
    """Return the part and position that a bundle inspects."""
    return PartPosition(bundle.manifest.part, bundle.manifest.position)


@dataclass(frozen=True)
class OpenBundle:
    """One bundle, ready to score."""

    path: Path
    """Where it is configured."""
    names: tuple[str, ...]
    """Names that select it, other than `part/position`."""
    inspector: Inspector
    golden_difference: float
    """The largest of its golden scores when it was opened."""
    instead_of: str | None = None
    """The id of the configured bundle whose place it has taken."""

    @property
    def bundle(self) -> Bundle:
        return self.inspector.bundle

    @property
    def part(self) -> PartPosition:
        return part_of(self.bundle)


@dataclass(frozen=True)
class BundleSet:
    """The bundles of a station, in the order of the configuration."""

    bundles: Mapping[PartPosition, OpenBundle] = field(default_factory=dict)
    shadows: Mapping[PartPosition, OpenBundle] = field(default_factory=dict)
    shadow_faults: tuple[str, ...] = ()
    """Why configured shadows are not scored, a sentence each."""

    def __getitem__(self, part: PartPosition) -> OpenBundle:
        return self.bundles[part]

    def __contains__(self, part: object) -> bool:
        return part in self.bundles

    def at(self, path: Path) -> OpenBundle | None:
        """The bundle that was opened from there."""
        every = (*self.bundles.values(), *self.shadows.values())
        return next((one for one in every if one.path == path), None)

    def may_inspect(self, one: OpenBundle) -> bool:
        """Say whether this one inspects its position, or is what a shadow has taken the place of: no mere shadow."""
        used = self.bundles.get(one.part)
        return used is not None and one.bundle.digest in (used.bundle.digest, used.instead_of)

    def find(self, part: str, position: str | None = None) -> PartPosition:
        """Return the position of this part. Errors: ValueError, which names those known."""
        return find_part(self.bundles, part, position)

    def find_by_name(self, name: str) -> PartPosition:
        """Return the position with this name, such as the code on the part. Errors: ValueError."""
        names = {name: bundle.part for bundle in self.bundles.values() for name in bundle.names}
        return find_named(self.bundles, names, name)

    def find_all(self, name: str) -> frozenset[PartPosition]:
        """Return all positions with this name: several for a part with several positions, none for an unknown
        name."""
        named = frozenset(bundle.part for bundle in self.bundles.values() if name in bundle.names)
        return named or frozenset(part for part in self.bundles if name in (part.part, str(part)))

    def with_one(self, new: OpenBundle) -> "BundleSet":
        """Return this set with one more bundle. Errors: ConfigError for a position that has one,
        BundleMismatch for a bundle that needs another reading of the sensor."""
        if (other := self.bundles.get(new.part)) is not None:
            raise ConfigError(
                f"bundle {new.path} is for {new.part}, as {other.path} is; name one of them for this position"
            )
        for other in self.bundles.values():
            _check_same_reading(other.bundle, new.bundle)
        return replace(self, bundles={**self.bundles, new.part: new})

    def with_shadow(self, new: OpenBundle) -> "BundleSet":
        """Return this set with one more shadow. Errors: ConfigError, BundleMismatch for one that cannot be compared
        with the bundle of its position."""
        used, where = self.bundles.get(new.part), f"shadow {new.path}"
        if used is None:
            raise ConfigError(f"{where} is for {new.part}, of which this station has no bundle")
        if used.bundle.digest == new.bundle.digest:
            raise ConfigError(f"{where} is the bundle of {new.part} itself; name another one")
        if (other := self.shadows.get(new.part)) is not None:
            raise ConfigError(f"{where} is for {new.part}, as {other.path} is; name one of them")
        for name in ("profile", "region"):
            used_entry, new_entry = getattr(used.bundle.manifest, name), getattr(new.bundle.manifest, name)
            if used_entry != new_entry:
                fields, others = asdict(used_entry), asdict(new_entry)
                differ = ", ".join(
                    f"{key} {others[key]}, not {fields[key]}" for key in fields if fields[key] != others[key]
                )
                raise BundleMismatch(
                    f"{where} has another {name} than {used.path} ({differ}); fit both with one {name}"
                )
        for golden in new.bundle.golden:
            highest = max(map(max, golden.map_peaks))
            if not math.isclose(highest, golden.score, rel_tol=_SAME):
                raise BundleMismatch(
                    f"{where} has a score that is not the highest value of its map ({golden.score:.4g} and "
                    f"{highest:.4g} of a golden frame), so places under scars cannot be left out of it; use it as a "
                    "bundle, without a shadow"
                )
        return replace(self, shadows={**self.shadows, new.part: new})

    def exchange(self, part: PartPosition) -> "BundleSet":
        """Return this set with the shadow of a position in the place of its bundle, and the other way round."""
        used, shadow = self.bundles[part], self.shadows[part]
        instead_of = None if used.instead_of else used.bundle.digest
        inspects = replace(shadow, names=used.names, instead_of=instead_of)
        beside = replace(used, names=(), instead_of=None)
        return replace(self, bundles={**self.bundles, part: inspects}, shadows={**self.shadows, part: beside})


def _check_same_reading(first: Bundle, other: Bundle) -> None:
    """A switch between presses leaves the sensor running and keeps the learnt picture of the free gel."""
    for name in ("native", "border", "controls"):
        first_setting, other_setting = getattr(first.profile, name), getattr(other.profile, name)
        if first_setting != other_setting:
            raise BundleMismatch(
                f"bundle {other.where} needs the sensor's {name} {other_setting}, bundle {first.where} of the same "
                f"station {first_setting}; fit both with one profile"
            )
