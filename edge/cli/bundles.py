"""`gelgate bundle inspect` and `gelgate bundle verify`: what is in a bundle, and whether it is sound."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from edge.cli.options import BundlePath, TrunkStore
from edge.core.errors import BundleError
from edge.core.printable import write_count
from edge.model.again_facts import DEFAULT_COSTS, again_sentence, plan_for
from edge.model.archive import MANIFEST, open_archive
from edge.model.bundle import MAX_MANIFEST_BYTES, Bundle, parse_manifest
from edge.model.detectability import detectability_lines, read_card
from edge.model.manifest import ColourEntry, Manifest
from edge.model.manifest_facts import (
    AUGMENTATION,
    LIMIT,
    MISSING,
    choice_sentence,
    licence_sentence,
    promise,
)
from edge.model.scorer import Scorer
from edge.model.signature import Trust, trusted_keys
from edge.model.trial import try_bundle

__all__ = ["inspect", "verify"]

TrustedKeys = Annotated[
    Path | None, typer.Option("--keys", help="Folder of <name>.pub: check the signature against these keys.")
]

VERIFICATION_FAILED = 5


def inspect(
    bundle: BundlePath,
    as_json: Annotated[bool, typer.Option("--json", help="Print the complete manifest as JSON.")] = False,
    keys: TrustedKeys = None,
) -> None:
    """Show what a bundle contains, from its manifest.

    Part, method, sensor profile, bank, threshold, cost, provenance. `verify` checks the files too.
    """
    archive = open_archive(bundle)
    raw = archive.read(MANIFEST, MAX_MANIFEST_BYTES)
    manifest = parse_manifest(raw, archive.where)
    if as_json:
        typer.echo(manifest.model_dump_json(indent=2))
        return
    signature = Trust(keys=trusted_keys(keys) if keys else {}).check(archive, raw)
    rows = [*_rows(manifest), ("bundle id", hashlib.sha256(raw).hexdigest()), ("signature", signature)]
    width = max(len(label) for label, _ in rows)
    for label, value in rows:
        typer.echo(f"{label:<{width}}  {value}")


def _rows(manifest: Manifest) -> Iterator[tuple[str, str]]:
    limit, profile, tolerance, facts = (
        manifest.threshold,
        manifest.profile,
        manifest.tolerance,
        manifest.facts,
    )
    size = "x".join(map(str, profile.size))
    yield "part", f"{manifest.part}, position {manifest.position}"
    yield "revision", str(manifest.revision or "none")
    for warning in manifest.provenance.warnings:
        yield "warning", warning
    yield "method", manifest.method + (f", mode {manifest.mode}" if manifest.mode else "")
    yield "parameters", ", ".join(f"{k}={v}" for k, v in manifest.parameters.items()) or "none"
    yield "repairs", ", ".join(manifest.repairs) or "none"
    yield "sensor profile", f"{profile.name}, picture {size}, {profile.pixels_per_mm:.2f} pixels/mm"
    yield "region", f"{manifest.region} (x,y,WIDTHxHEIGHT)"
    yield "smoothed", "over 3x3 pixels, against noise" if manifest.is_smoothed else "no"
    yield from _graph_rows(manifest)
    yield "augmentation", choice_sentence(facts, AUGMENTATION) or "none"
    yield "threshold", f"{limit.value:.6g} ({limit.method})"
    yield "limit", choice_sentence(facts, LIMIT) or "plain"
    yield "missing relief", choice_sentence(facts, MISSING) or "not checked"
    for name, label in (("registration", "registration"), ("free_gel", "free gel"), ("dots", "marker dots")):
        if name in facts:
            yield label, str(facts[name])
    yield "false alarms", promise(limit)
    if drawn := manifest.regions:
        yield "drawn regions", drawn.describe() or "none"
    yield "press again", again_sentence(plan_for(manifest, DEFAULT_COSTS))
    absolute = f"score {tolerance.score:.2g}, map {tolerance.score_map:.2g}"
    yield "tolerance", f"{absolute}, relative {tolerance.relative:.2g}"
    golden = ", ".join(f"{frame.what} {frame.score:.4g}" for frame in manifest.golden)
    yield "shown beside", _shown_beside(manifest)
    yield "golden frames", f"{len(manifest.golden)}: {golden}"
    yield from _cards(manifest)


def _graph_rows(manifest: Manifest) -> Iterator[tuple[str, str]]:
    """Describe the trunk, its taps and tiles, the other graphs and the bank."""
    backbone, grid = manifest.backbone, manifest.grid
    if backbone is not None:
        place = "in the bundle" if backbone.in_bundle else "in the gateway's trunk store"
        trunk = f"{_mb(backbone.trunk.size_bytes)}, {place}, {backbone.trunk.sha256[:12]}"
        yield "trunk", f"{backbone.id}, {trunk}"
    if grid:
        yield "taps", ", ".join(f"{name} {c}x{h}x{w}" for name, (c, h, w) in grid.taps.items())
    if grid and grid.tiles:
        count, skipped = len(grid.tiles.tiles(grid.frame)), len(grid.tiles.untouched)
        yield "tiles", f"{count} of {grid.tiles.size}, {skipped} of them run only when a press touches them"
    for graph in (manifest.head, manifest.detector):
        if graph:
            yield graph.file, f"{_mb(graph.size_bytes)}, {graph.sha256[:12]}"
    for name, array in manifest.bank.items():
        shape = "x".join(map(str, array.shape)) or "one value"
        stored = f"stored as {array.packing} in {_mb(array.bytes_stored)}"
        yield f"bank {name}", f"{array.dtype} {shape}, {_mb(array.bytes_unpacked)}, {stored}"


def _cards(manifest: Manifest) -> Iterator[tuple[str, str]]:
    """Describe the licence, what was measured, and where the bundle comes from."""
    cost, origin = manifest.cost, manifest.provenance
    if licence := licence_sentence(manifest):
        yield "licence", licence.removeprefix("licence of the ")
    if manifest.contact:
        spans = {name: getattr(manifest.contact, name) for name in ("x", "y", "area")}
        yield "contact", ", ".join(f"{k} {low:.2f} to {high:.2f}" for k, (low, high) in spans.items())
    yield "colours", _colours(manifest.colours)
    if cost:
        press = f"trunk {cost.trunk_ms:.1f} ms, head {cost.head_ms:.1f} ms, {cost.threads} threads"
        yield "cost", f"{press}, on the machine of the fit"
        times = f"features {cost.features_s:.1f} s, bank {cost.fit_s:.1f} s"
        yield "fit", f"{times}, threshold {cost.threshold_s:.1f} s"
    if manifest.accuracy:
        yield "accuracy", ", ".join(f"{k} {v:.4f}" for k, v in manifest.accuracy.items())
    if card := read_card(manifest.facts):
        yield from (("detectability", line) for line in detectability_lines(card))
    versions = ", ".join(f"{k} {v}" for k, v in origin.versions.items())
    yield "made", f"{origin.created}, {len(origin.presses)} presses, seed {origin.seed}, {versions}"
    yield from (("left out", name) for name in origin.left_out)


def _shown_beside(manifest: Manifest) -> str:
    pictures = manifest.nominal_pictures
    if pictures is None:
        return "nothing: a press that fails is shown without what it was compared with; fit again"
    count, first = len(pictures.names), pictures.names[0]
    return f"{_mb(pictures.file.size_bytes)}: {first if count == 1 else f'the most alike of {count} nominal presses'}"


def _colours(colours: ColourEntry | None) -> str:
    if colours is None:
        return "unknown: frames of another sensor are not refused; fit again"
    return f"refused beyond {colours.limit:.1%} of the light, nominal presses differ by {colours.spread:.1%}"


def _mb(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:.2f} MB" if size_bytes >= 10_000 else f"{size_bytes} bytes"


def verify(
    bundle: BundlePath,
    trunks: TrunkStore = None,
    threads: Annotated[int, typer.Option(min=1, max=64, help="Threads of the runtime.")] = 2,
    keys: TrustedKeys = None,
) -> None:
    """Check a bundle's files and its scores on this machine.

    Checked: signature, schema, every hash, the graphs, the scores of the golden frames. With --keys an unsigned bundle
    fails. Exit code 5 when a check fails.
    """
    trust = Trust("required", trusted_keys(keys)) if keys else Trust()
    try:
        try_bundle(bundle, trunks, threads)
        checked = Bundle.load(bundle, trunks, trust=trust)
        typer.echo(f"signature: {checked.signature}")
        typer.echo(f"manifest schema {checked.manifest.schema_version}: known")
        typer.echo(f"{write_count(len(checked.manifest.files), 'file')}: every SHA-256 is correct")
        scorer = Scorer(checked, threads)
        typer.echo("graphs: they open, and give the promised shapes")
        worst = scorer.check_golden()
        typer.echo(f"{len(checked.golden)} golden frames: scores agree, largest difference {worst:.2g}")
    except BundleError as error:
        typer.echo(f"gelgate: {error}", err=True)
        raise typer.Exit(VERIFICATION_FAILED) from error
    typer.echo(f"bundle {bundle} is sound")
