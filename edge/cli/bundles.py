"""`gelgate bundle inspect` and `gelgate bundle verify`: what is in a bundle, and whether it is sound."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edge.cli.options import BundlePath, TrunkStore

if TYPE_CHECKING:
    from edge.model.manifest import ColourEntry, Manifest

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
    import hashlib

    from edge.model.archive import MANIFEST, open_archive
    from edge.model.bundle import MAX_MANIFEST_BYTES, parse_manifest
    from edge.model.signature import Trust, trusted_keys

    archive = open_archive(bundle)
    raw = archive.read(MANIFEST, MAX_MANIFEST_BYTES)
    manifest = parse_manifest(raw, archive.where)
    if as_json:
        typer.echo(manifest.model_dump_json(indent=2))
        return
    signature = Trust(keys=trusted_keys(keys) if keys else {}).check(archive, raw).text
    rows = [*_rows(manifest), ("bundle id", hashlib.sha256(raw).hexdigest()), ("signature", signature)]
    width = max(len(label) for label, _ in rows)
    for label, value in rows:
        typer.echo(f"{label:<{width}}  {value}")


def _rows(manifest: "Manifest") -> list[tuple[str, str]]:
    from edge.model.manifest_facts import (
        AUGMENTATION,
        LIMIT,
        METHOD_CHOICE,
        MISSING,
        choice_sentence,
        promise,
    )
    from edge.model.press_again_facts import DEFAULT_COSTS, again_sentence, plan_for

    limit, profile, grid = manifest.threshold, manifest.profile, manifest.grid
    rows = [
        ("part", f"{manifest.part}, position {manifest.position}"),
        ("revision", str(manifest.revision or "none")),
        *(("warning", warning) for warning in manifest.provenance.warnings),
        ("method", manifest.method + (f", mode {manifest.mode}" if manifest.mode else "")),
        ("method choice", choice_sentence(manifest.facts, METHOD_CHOICE) or "named, not chosen by the fit"),
        ("parameters", ", ".join(f"{k}={v}" for k, v in manifest.parameters.items()) or "none"),
        ("repairs", ", ".join(manifest.repairs) or "none"),
        (
            "sensor profile",
            f"{profile.name}, picture {profile.size[0]}x{profile.size[1]}, {profile.pixels_per_mm:.2f} pixels/mm",
        ),
        ("region", f"{manifest.region.region()} (x,y,WIDTHxHEIGHT)"),
    ]
    rows += _trunk_rows(manifest)
    if grid:
        rows.append(("taps", ", ".join(f"{name} {c}x{h}x{w}" for name, (c, h, w) in grid.taps.items())))
    if grid and grid.tiles:
        count, skipped = len(grid.tiles.tiles(grid.frame)), len(grid.tiles.untouched)
        rows.append(
            ("tiles", f"{count} of {grid.tiles.size}, {skipped} of them run only when a press touches them")
        )
    graphs = [graph for graph in (manifest.head, manifest.detector) if graph]
    rows += [(graph.file, f"{_mb(graph.size_bytes)}, {graph.sha256[:12]}") for graph in graphs]
    for name, array in manifest.bank.items():
        shape = "x".join(map(str, array.shape)) or "one value"
        rows.append(
            (
                f"bank {name}",
                f"{array.dtype} {shape}, {_mb(array.bytes_unpacked)}, stored as {array.packing} "
                f"in {_mb(array.bytes_stored)}",
            )
        )
    rows += [
        ("augmentation", choice_sentence(manifest.facts, AUGMENTATION) or "none"),
        ("threshold", f"{limit.value:.6g} ({limit.method})"),
        ("limit", choice_sentence(manifest.facts, LIMIT) or "plain"),
        ("missing relief", choice_sentence(manifest.facts, MISSING) or "not checked"),
        ("false alarms", promise(limit)),
        ("press again", again_sentence(plan_for(manifest, DEFAULT_COSTS))),
        ("tolerance", f"score {manifest.tolerance.score:.2g}, map {manifest.tolerance.score_map:.2g}, "
         f"relative {manifest.tolerance.relative:.2g}"),
        ("golden frames", f"{len(manifest.golden)}: " + ", ".join(f"{g.what} {g.score:.4g}" for g in manifest.golden)),
    ]  # fmt: skip
    return rows + _cards(manifest)


def _trunk_rows(manifest: "Manifest") -> list[tuple[str, str]]:
    from edge.model.manifest_facts import BACKBONE_CHOICE, choice_sentence

    if manifest.backbone is None:
        return []
    trunk = manifest.backbone.trunk
    place = "in the bundle" if manifest.backbone.in_bundle else "in the gateway's trunk store"
    said = f"{manifest.backbone.id}, {_mb(trunk.size_bytes)}, {place}, {trunk.sha256[:12]}"
    return [
        ("trunk", said),
        ("backbone", choice_sentence(manifest.facts, BACKBONE_CHOICE) or "named, not chosen by the fit"),
    ]


def _cards(manifest: "Manifest") -> list[tuple[str, str]]:
    from edge.model.detectability import detectability_lines
    from edge.model.manifest_facts import licence_sentence

    rows = []
    if licence := licence_sentence(manifest):
        rows.append(("licence", licence.removeprefix("licence of the ")))
    if manifest.contact:
        spans = {name: getattr(manifest.contact, name) for name in ("x", "y", "area")}
        rows.append(
            ("contact", ", ".join(f"{k} {low:.2f} to {high:.2f}" for k, (low, high) in spans.items()))
        )
    rows.append(("colours", _colours(manifest.colours)))
    if manifest.cost:
        cost = manifest.cost
        rows.append(
            (
                "cost",
                f"trunk {cost.trunk_ms:.1f} ms, head {cost.head_ms:.1f} ms, {cost.threads} threads, "
                f"on the machine of the fit",
            )
        )
        rows.append(
            (
                "fit",
                f"features {cost.features_s:.1f} s, bank {cost.fit_s:.1f} s, threshold {cost.threshold_s:.1f} s",
            )
        )
    if manifest.accuracy:
        rows.append(("accuracy", ", ".join(f"{k} {v:.4f}" for k, v in manifest.accuracy.items())))
    if manifest.detectability:
        rows += [("detectability", line) for line in detectability_lines(manifest.detectability)]
    origin = manifest.provenance
    rows.append(
        (
            "made",
            f"{origin.created}, {len(origin.presses)} presses, seed {origin.seed}, "
            + ", ".join(f"{k} {v}" for k, v in origin.versions.items()),
        )
    )
    rows += [("left out", name) for name in origin.left_out]
    return rows


def _colours(colours: "ColourEntry | None") -> str:
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
    from edge.core.errors import BundleError
    from edge.model.bundle import Bundle
    from edge.model.scorer import Scorer
    from edge.model.signature import Trust, trusted_keys
    from edge.model.trial import try_bundle

    trust = Trust("required", trusted_keys(keys)) if keys else Trust()
    try:
        try_bundle(bundle, trunks, threads)
        checked = Bundle.load(bundle, trunks, trust=trust)
        typer.echo(f"signature: {checked.signature.text}")
        typer.echo(f"manifest schema {checked.manifest.schema_version}: known")
        typer.echo(f"{len(checked.manifest.files)} files: every SHA-256 is correct")
        scorer = Scorer(checked, threads)
        typer.echo("graphs: they open, and give the promised shapes")
        worst = scorer.check_golden()
        typer.echo(f"{len(checked.golden)} golden frames: scores agree, largest difference {worst:.2g}")
    except BundleError as error:
        typer.echo(f"gelgate: {error}", err=True)
        raise typer.Exit(VERIFICATION_FAILED) from error
    typer.echo(f"bundle {bundle} is sound")
