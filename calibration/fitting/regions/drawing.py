"""Drawn regions: as people write them, and a bundle with others, whose head weighs the score map by them.

The weights are one more array of the bank, so the gateway, the exports and other programs score such a bundle as any
other. Relief that is missing is a property of the whole press, so it counts in ignored places too. People write

    [[regions]]
    name = "logo"
    kind = "ignore"
    points_mm = [[3.1, 4.0], [6.2, 4.0], [6.2, 7.5]]

in a TOML file, and on the command line `ignore logo 3.1,4 6.2,4 6.2,7.5`. `stricter` has a `factor` too: `stricter seam
1.5 2,2 8,2 8,4`.
"""

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from calibration.fitting.bundle_measurements import score_again
from calibration.fitting.fit import Fitted
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.limits.appended import TAUGHT_WEIGHTS, append
from calibration.fitting.limits.threshold import promise_at
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.teach import FEWEST_HELD_OUT, find_other_score, hold_out
from edge.core.arrays import F32
from edge.core.contact.relief import find_contact
from edge.core.detector import Bank
from edge.core.drawn_regions import LEAST_JUDGED_MM2, DrawnRegion, DrawnRegions, find_blind, weigh_places
from edge.core.errors import ConfigError, FitError
from edge.model.archive import MANIFEST, open_archive
from edge.model.bundle import HEAD, Bundle, parse_manifest
from edge.model.bundle_writer import array_entry, keep_file, manifest_bytes
from edge.model.detectability import CARD
from edge.model.manifest import REGION_WEIGHTS, Manifest, ThresholdEntry
from edge.model.manifest_facts import DAMAGE_FOUND
from edge.model.scorer import Scorer

__all__ = [
    "draw_again",
    "draw_regions",
    "find_promise",
    "is_stricter",
    "parse_region",
    "read_regions",
    "write_regions",
]

# What a manifest says of scores, which are others now.
_OF_OLD_SCORES: Final = ("press_again", DAMAGE_FOUND, CARD)
# Where `ignore` leaves this share of the contact or less, a lighter press has too little left to be judged.
_LEAST_SHARE: Final = 0.1


def draw_regions(
    path: Path, regions: Sequence[DrawnRegion], limit: ThresholdEntry | None, threads: int
) -> Fitted:
    """Return the bundle at this path with these regions instead of its own, the next revision; what they do not change
    stays byte for byte. limit: its threshold with another promise; None where that holds as it is. Errors: FitError for
    regions that the bundle cannot have, BundleError."""
    old = Bundle.load(path)
    revision = (old.manifest.revision or 0) + 1
    return _draw(old, open_archive(path).read, regions, {"threshold": limit, "revision": revision}, threads)


def draw_again(
    old: Bundle, fitted: Fitted, nominal: NominalPresses, config: FitConfig, created: str
) -> Fitted:
    """Return what was fitted in the place of the old bundle with the regions of that, and what its limit promises with
    them. Errors: FitError where they would lie elsewhere on the part, or cannot be."""
    regions = old.manifest.regions.regions if old.manifest.regions else ()
    if not regions:
        return fitted
    new = fitted.bundle()
    try:
        before, now = (None if one is None else one.template for one in (old.registration, new.registration))
        if not np.array_equal(before, now):  # type: ignore[arg-type]  # None is equal to None alone
            raise FitError(
                "the new fit brings presses to another pose, so they would lie elsewhere on the part"
            )
        limit = find_promise(new, regions, nominal, config, created) if is_stricter(new, regions) else None
        return _draw(new, fitted.files.__getitem__, regions, {"threshold": limit}, config.threads)
    except FitError as error:
        names = " ".join(f"--remove '{region.name}'" for region in regions)
        raise FitError(
            f"the regions drawn on bundle {old.where} cannot be kept: {error}. To go on without them: `gelgate bundle "
            f"regions {old.where} {names} -o PLAIN`, and use PLAIN instead"
        ) from error


def _draw(
    old: Bundle,
    read: Callable[[str], bytes],
    regions: Sequence[DrawnRegion],
    said: Mapping[str, Any],
    threads: int,
) -> Fitted:
    """Draw the regions. read: gives a file of the bundle. said: of its manifest, what is not None. Errors: as
    `draw_regions`."""
    _check_head(old)
    manifest = old.manifest
    try:
        for region in regions:
            region.check_inside(manifest.frame, old.profile.mm_per_pixel)
        weights = weigh_places(regions, manifest.frame, old.profile.mm_per_pixel)
        drawn = DrawnRegions(tuple(regions))
    except ValueError as error:
        raise FitError(str(error)) from error
    drawn = replace(drawn, **_measure_contact(old, weights, regions))
    bank, graphs = dict(old.bank), old.graphs
    if REGION_WEIGHTS not in bank:
        head, _ = append(graphs.head or b"", Bank(bank), {REGION_WEIGHTS: weights})
        graphs = replace(graphs, head=head)
    new = replace(old, graphs=graphs, bank={**bank, REGION_WEIGHTS: weights})
    scorer = Scorer(new, threads)
    golden = [score_again(press, scorer) for press in old.golden]
    files = {entry.file: read(entry.file) for entry in manifest.files}
    keep = partial(keep_file, files)
    changes = _change_facts(manifest, drawn, float(weights.max()))
    changes |= {name: value for name, value in said.items() if value is not None}
    changes |= {
        "head": keep(HEAD, graphs.head or b""),
        "bank": {**manifest.bank, REGION_WEIGHTS: array_entry(REGION_WEIGHTS, Bank(new.bank), keep)},
        "golden": tuple(
            entry.model_copy(update={"score": frame.score, "map_peaks": frame.map_peaks})
            for entry, frame in zip(manifest.golden, golden, strict=True)
        ),
    }
    files[MANIFEST] = manifest_bytes(manifest.model_copy(update=changes))
    return Fitted(parse_manifest(files[MANIFEST], old.where), files)


def _change_facts(manifest: Manifest, drawn: DrawnRegions, most: float) -> dict[str, Any]:
    """Return what the manifest says otherwise of scores. most: the largest weight."""
    tolerance, larger = manifest.tolerance, max(most, 1.0)
    widened = {name: larger * getattr(tolerance, name) for name in ("score", "score_map", "measured")}
    return {
        "regions": drawn,
        "facts": {name: fact for name, fact in manifest.facts.items() if name not in _OF_OLD_SCORES},
        "tolerance": tolerance.model_copy(update=widened),
        "accuracy": None,
    }


def is_stricter(old: Bundle, regions: Sequence[DrawnRegion]) -> bool:
    """Tell whether some place is judged more strictly than before: then the promise of the limit may not hold."""
    before = old.bank.get(REGION_WEIGHTS, np.float32(1))
    now = weigh_places(regions, old.manifest.frame, old.profile.mm_per_pixel)
    return bool((now > np.maximum(before, 1)).any())


def find_promise(
    old: Bundle, regions: Sequence[DrawnRegion], nominal: NominalPresses, config: FitConfig, created: str
) -> ThresholdEntry:
    """Return the threshold with what it promises with these regions, by fits that each leave out a part of the nominal
    presses. Errors: FitError for too few, and where every sound press would fail."""
    limit = old.manifest.threshold
    held_out = hold_out(old, nominal, config, created)
    if held_out is None:
        raise FitError(
            f"of the {len(nominal)} nominal presses at least {FEWEST_HELD_OUT} with a score are needed, which tell "
            "what a stricter region costs; give those of the fit"
        )
    weights = weigh_places(regions, old.manifest.frame, old.profile.mm_per_pixel)
    sound, maps = held_out
    maps = maps * old.bank.get(TAUGHT_WEIGHTS, np.float32(1))
    scores = (maps * weights).max(axis=(1, 2)) * limit.value
    threshold = promise_at(scores, limit.value, limit.alpha, sound.specimens)
    if threshold is None:
        highest = maps[:, weights > 1].max(axis=1)
        usual, most = float(np.median(highest)), float(highest.max())
        harmless = math.floor(100 / most) / 100
        raise FitError(
            f"with these factors every sound press would fail: nominal ones reach {most:.2f} of the limit there, half "
            f"of them {usual:.2f}, so a factor of {harmless:.2f} fails none of them and {1 / usual:.2f} half; choose "
            "smaller ones, or draw other regions"
        )
    return threshold.model_copy(update={"method": f"{limit.method}; the promise with the drawn regions"})


def _check_head(old: Bundle) -> None:
    """Errors: FitError for a bundle whose score map cannot be weighed."""
    manifest = old.manifest
    if manifest.head is None or old.graphs.trunk is None:
        why = "it is a single graph of another tool" if manifest.head is None else "its trunk is not here"
        raise FitError(f"bundle {old.where} cannot have regions: {why}; fit a bundle with `gelgate fit`")
    if (part := old.registration) is not None and part.symmetry != 1 and not part.is_held:
        often = f"{part.symmetry} times in a full turn" if part.symmetry else "in every turn"
        raise FitError(
            f"bundle {old.where} cannot have regions: its part looks the same {often}, so nobody knows where on it one "
            "would lie; fit it with --set register=never, and hold the part in one pose"
        )
    if not manifest.threshold.value > 0:
        raise FitError(
            f"bundle {old.where} cannot have regions: its threshold is {manifest.threshold.value:.4g}, and scores are "
            "multiplied by factors; fit it from presses"
        )
    if not old.golden:
        raise FitError(
            f"bundle {old.where} cannot have regions: it has no golden frames to prove them; fit it again"
        )
    if why := find_other_score(old):
        raise FitError(
            f"bundle {old.where} cannot have regions: {why}, so no place can be left out of it; fit it with another "
            "method, or with mode=corrected"
        )


def _measure_contact(old: Bundle, weights: F32, regions: Sequence[DrawnRegion]) -> dict[str, Any]:
    """Measure what of the nominal contact is ignored, and the nominal contact, mm2; 0 where nothing is ignored. Errors:
    FitError for regions that leave nothing to judge, or where the contact is not known."""
    blind = find_blind(weights)
    if blind is None:
        return {}
    if (free := old.free_region) is None:
        raise FitError(
            f"bundle {old.where} does not know the free gel, so a press that lies in ignored regions alone would not "
            "be noticed; fit it again with pictures of the free gel (--no-contact)"
        )
    x_mm, y_mm = old.profile.mm_per_pixel
    free = old.prepare(free)
    contact = np.zeros(blind.shape, bool)
    for press in old.golden:
        if press.score <= old.manifest.threshold.value:
            contact |= find_contact(press.rgb, free, old.profile.size)
    whole, judged = (np.count_nonzero(one) * x_mm * y_mm for one in (contact, contact & ~blind))
    if judged < LEAST_JUDGED_MM2:
        raise FitError(
            f"these regions leave {judged:.1f} mm2 of the {whole:.1f} mm2 that nominal presses touch, expected at "
            f"least {LEAST_JUDGED_MM2:g} mm2: nothing would be judged; make what is ignored smaller"
        )
    if judged <= _LEAST_SHARE * whole and not any(region.kind == "judge" for region in regions):
        raise FitError(
            f"these regions ignore {whole - judged:.1f} mm2 of the {whole:.1f} mm2 that nominal presses touch, "
            f"expected less than {100 * (1 - _LEAST_SHARE):g} %: presses would be rejected, for too little of them is "
            "judged; make what is ignored smaller, or draw what is judged as 'judge'"
        )
    return {"ignored_mm2": round(whole - judged, 2), "contact_mm2": round(whole, 2)}


_KEYS: Final = ("name", "kind", "points_mm", "factor")


def read_regions(path: Path) -> list[DrawnRegion]:
    """Read a file of regions. Errors: ConfigError."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}; name a TOML file of regions") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path} is no TOML file: {error}; `gelgate bundle regions` prints one") from error
    tables = content.get("regions")
    if set(content) != {"regions"} or not isinstance(tables, list):
        raise ConfigError(f"{path} has {sorted(content) or 'nothing'}, expected tables [[regions]] alone")
    return [_region(path, table) for table in tables]


def _region(where: object, table: Any) -> DrawnRegion:
    if not isinstance(table, Mapping) or (unknown := sorted(table.keys() - {*_KEYS})):
        stray = table if not isinstance(table, Mapping) else unknown[0]
        raise ConfigError(f"{where}: a region has {', '.join(_KEYS)}, found '{stray!s:.60}'")
    if missing := [key for key in _KEYS[:3] if key not in table]:
        raise ConfigError(f"{where}: a region lacks {missing[0]}; it has {', '.join(_KEYS)}")
    try:
        points = tuple((float(x), float(y)) for x, y in table["points_mm"])
        return DrawnRegion(str(table["name"]), table["kind"], points, float(table.get("factor", 1.0)))
    except (TypeError, ValueError) as error:
        why = (
            str(error)
            if str(error).startswith(("region", "a region"))
            else f"points_mm are [x, y] in mm ({error})"
        )
        raise ConfigError(f"{where}: {why}") from error


def parse_region(text: str) -> DrawnRegion:
    """Read the region of a text. Errors: ConfigError."""
    kind, _, rest = text.strip().partition(" ")
    name, _, rest = rest.strip().partition(" ")
    words, factor = rest.split(), dict[str, float]()
    if kind == "stricter" and words and "," not in words[0]:
        factor["factor"] = _number(text, words.pop(0))
    if not words:
        raise ConfigError(f"'{text}' has no place; write 'ignore NAME x,y x,y x,y' in mm")
    points = [_point(text, word) for word in words]
    return _region(f"'{text}'", {"name": name, "kind": kind, "points_mm": points, **factor})


def _point(text: str, word: str) -> tuple[float, float]:
    x, comma, y = word.partition(",")
    if not comma:
        raise ConfigError(f"'{text}': found '{word}', expected a point as x,y in mm")
    return _number(text, x), _number(text, y)


def _number(text: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise ConfigError(f"'{text}': found '{word}', expected a number; points are x,y in mm") from None


def write_regions(regions: Sequence[DrawnRegion]) -> str:
    """Write them as a file that `read_regions` reads."""
    texts = []
    for region in regions:
        points = ", ".join(f"[{x:g}, {y:g}]" for x, y in region.points_mm)
        factor = f"factor = {region.factor:g}\n" if region.kind == "stricter" else ""
        name = region.name.replace("\\", "\\\\").replace('"', '\\"')
        texts.append(
            f'[[regions]]\nname = "{name}"\nkind = "{region.kind}"\n{factor}points_mm = [{points}]\n'
        )
    return "\n".join(texts)
