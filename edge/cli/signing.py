"""`gelgate bundle sign` and `gelgate bundle keys`: who made a bundle."""

from pathlib import Path
from typing import Annotated

import typer

from edge.cli.options import BundlePath
from edge.core.errors import ConfigError
from edge.model.archive import MANIFEST, open_archive
from edge.model.bundle import MAX_MANIFEST_BYTES, Bundle
from edge.model.bundle_writer import add_file
from edge.model.signature import (
    PRIVATE_SUFFIX,
    PUBLIC_SUFFIX,
    SIGNATURE,
    fingerprint,
    read_public_key,
    trusted_keys,
)
from edge.model.signing import new_key, read_private_key
from edge.model.signing import sign as signature_of

__all__ = ["keys", "sign"]

keys = typer.Typer(no_args_is_help=True, help="Make and show the keys that bundles are signed with.")


def sign(
    bundle: BundlePath,
    key: Annotated[Path, typer.Option("--key", "-k", help="The private key, <name>.key.")],
) -> None:
    """Sign a bundle, so that a gateway can tell who made it.

    Every file is checked first. The signature covers the manifest, which has the hash of every other file; a later
    change of the bundle makes it invalid. A signature that exists is replaced.
    """
    private = read_private_key(key)
    digest = Bundle.load(bundle).digest
    raw = open_archive(bundle).read(MANIFEST, MAX_MANIFEST_BYTES)
    add_file(bundle, SIGNATURE, signature_of(raw, private))
    typer.echo(f"signed {bundle} with key {fingerprint(private.public_key())}; bundle id {digest}")


@keys.command()
def new(
    name: Annotated[
        Path, typer.Argument(metavar="NAME", help="Path without ending: NAME.key and NAME.pub are written.")
    ],
) -> None:
    """Make a key pair.

    Keep NAME.key secret and off the gateway; copy NAME.pub into the folder `inspection.trusted_keys` of every gateway.
    """
    try:
        made = new_key(name)
    except FileExistsError as error:
        raise ConfigError(
            f"{error.filename} exists already and is not replaced; choose another name"
        ) from error
    typer.echo(
        f"key {made}: {name}{PRIVATE_SUFFIX} (secret, signs) and {name}{PUBLIC_SUFFIX} (for the gateways)"
    )


@keys.command()
def show(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A <name>.pub, or a folder of them.")],
) -> None:
    """Print the fingerprint of each key.

    `inspect`, `verify` and `check` name keys by it.
    """
    if path.is_dir():
        marks = {name: mark for mark, (name, _) in trusted_keys(path).items()}
    else:
        marks = {path.stem: fingerprint(read_public_key(path))}
    for name, mark in marks.items():
        typer.echo(f"{mark}  {name}")
