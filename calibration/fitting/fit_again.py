"""A bundle fitted again: its nominal presses, and the settings of its fit as its manifest states them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from calibration.fitting.fit_config import SETTINGS, FitConfig
from calibration.fitting.presses.nominal_presses import (
    NominalPresses,
    is_recording,
    read_presses,
)
from calibration.fitting.presses.sources import (
    check_present,
    find_sources,
    list_pictures,
    name_apart,
)
from calibration.fitting.trunks import open_trunk
from edge import registry
from edge.core.errors import FitError
from edge.model.bundle import Bundle

__all__ = ["configure_again", "read_again"]


def configure_again(old: Bundle, alpha: float | None, threads: int, gel: str | None) -> FitConfig:
    """Make the configuration of a fit like that of the old bundle. alpha: None for that of the bundle. Errors: FitError
    for a bundle of another origin."""
    manifest = old.manifest
    if manifest.backbone is None or manifest.mode is None:
        raise FitError(f"bundle {old.where} is no bundle of `gelgate fit`, so it cannot be fitted again")
    detector = registry.detector(manifest.method)
    usual = json.loads(json.dumps(dict(vars(detector.parameters(manifest.mode)))))
    overrides = {
        name: value for name, value in manifest.parameters.items() if value != usual.get(name, value)
    }
    asked = _settings(old)
    return FitConfig(
        part=manifest.part,
        position=manifest.position,
        profile=old.profile,
        region=old.region,
        detector=detector,
        trunk=open_trunk(
            manifest.backbone.id, detector.taps(detector.parameters(manifest.mode, **overrides))
        ),
        mode=manifest.mode,
        overrides=overrides,
        alpha=manifest.threshold.alpha if alpha is None else alpha,
        seed=asked.get("seed", 0),
        folds=asked.get("folds", 5),
        threads=threads,
        with_trunk=manifest.backbone.in_bundle,
        is_scattered=asked.get("scattered", False),
        limit=asked.get("limit", "chosen"),
        register=asked.get("register", "auto"),
        augment=asked.get("augment", "auto"),
        revision=(manifest.revision or 0) + 1,
        gel_id=gel,
        # With the same pose the new bundle, as a shadow, takes the features of the old one.
        pose=None if old.registration is None else replace(old.registration, gel_limits=None),
        settings=asked,
    )


def read_again(
    old: Bundle,
    sources: Sequence[Path],
    *,
    more: Sequence[Path] = (),
    no_contact: Sequence[Path] | None,
    leave_out: Sequence[str],
) -> NominalPresses:
    """Read the nominal presses as the old fit did, less those that it left out. more: pictures beside them. Prints
    the names of those. Errors: as `read_presses`, `find_sources`."""
    check_present(sources)
    manifest, asked = old.manifest, _settings(old)
    press_sources = find_sources(
        sources,
        manifest.part,
        manifest.position,
        old.profile.size,
        holdout=asked.get("holdout", 0.0),
        seed=asked.get("seed", 0),
    )
    pattern = asked.get("pattern")
    if left_out := _left_out_before(press_sources.paths, manifest.provenance.left_out, pattern):
        typer.echo(f"left out as before: {', '.join(left_out)}")
    return read_presses(
        [*press_sources.paths, *more],
        old.profile,
        old.region,
        no_contact=no_contact,
        resize=asked.get("resize", False),
        pattern=pattern,
        specimens=press_sources.specimens,
        leave_out=[*left_out, *leave_out],
    )


def _settings(old: Bundle) -> Mapping[str, Any]:
    """Return what the old fit was asked for otherwise than usual; nothing of a fit before 0.2.0."""
    asked = old.manifest.facts.get(SETTINGS)
    return asked if isinstance(asked, Mapping) else {}


def _left_out_before(sources: Sequence[Path], names: Sequence[str], pattern: str | None) -> list[str]:
    """Name the presses that are still among the sources, of those that the old bundle left out. A name is the end of a
    path, as long as was needed among the sources of then."""
    recordings = [source for source in sources if is_recording(source)]
    files = list_pictures([source for source in sources if source not in recordings], pattern)
    ends = {f"/{name.lstrip('/')}" for name in names}
    there = [
        name
        for path, name in zip(files, name_apart(files, 2), strict=True)
        if any(path.absolute().as_posix().endswith(end) for end in ends)
    ]
    numbered = [end.rpartition("#") for end in sorted(ends) if "#" in end]
    for folder, name in zip(recordings, name_apart(recordings, 1), strict=True):
        path = folder.absolute().as_posix()
        there += [f"{name}#{number}" for end, _, number in numbered if path.endswith(end)]
    return there
