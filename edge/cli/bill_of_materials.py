"""What is installed, as a bill of materials in CycloneDX 1.6: packages, libraries in their wheels, weights, bundles.

Ref: CycloneDX 1.6 (ECMA-424), cyclonedx.org/docs/1.6/json; package URLs, ECMA-427; PEP 770 for bills in wheels.

It is read from the metadata that pip has left, and no package is imported. What pip did not install is not seen.
"""

import base64
import hashlib
import json
import os
import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import Distribution, PackageMetadata, PackagePath, distributions
from pathlib import Path
from typing import Any, Final
from uuid import NAMESPACE_URL, uuid5

from edge.model.archive import MANIFEST, open_archive
from edge.model.bundle import MAX_MANIFEST_BYTES, parse_manifest
from edge.model.manifest_facts import licence_of

__all__ = ["bill_of_materials", "package_component", "write_bill"]

_SHARED_LIBRARY: Final = re.compile(r"lib.+\.(so|dll|dylib)(\.|$)")


def bill_of_materials(bundles: Sequence[Path]) -> str:
    """Describe the program, all packages of this environment, and these bundles.

    Errors: BundleCorrupt, BundleMismatch.
    """
    packages: dict[str, Distribution] = {}
    for distribution in distributions():
        packages.setdefault(
            _name(distribution), distribution
        )  # of two with one name Python imports the first
    program = packages.pop("gelgate")
    components = [
        *(package_component(one) for _, one in sorted(packages.items())),
        *_surroundings(),
        *(component for path in bundles for component in _bundle_components(path)),
    ]
    unique = {component["bom-ref"]: component for component in components}
    needs = [
        {
            "ref": _url(one),
            "dependsOn": sorted({_url(packages[name]) for name in _needs(one) if name in packages}),
        }
        for one in (program, *(packages[name] for name in sorted(packages)))
    ]
    return write_bill(package_component(program, kind="application"), list(unique.values()), needs)


def write_bill(
    subject: Mapping[str, Any], components: Sequence[Mapping[str, Any]], needs: Sequence[Mapping[str, Any]]
) -> str:
    """Write the document. Its number follows from what it lists; its time is SOURCE_DATE_EPOCH where that is set."""
    content = {"components": list(components), "dependencies": list(needs)}
    number = uuid5(NAMESPACE_URL, json.dumps([subject, content], sort_keys=True))
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    time = datetime.now(UTC) if epoch is None else datetime.fromtimestamp(int(epoch), UTC)
    head = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{number}",
        "version": 1,
        "metadata": {
            "timestamp": time.strftime("%Y-%m-%dT%H:%M:%SZ"),
            "tools": {
                "components": [{"type": "application", "name": "gelgate", "version": subject["version"]}]
            },
            "component": subject,
        },
    }
    return json.dumps(head | content, indent=2, ensure_ascii=False) + "\n"


def package_component(package: Distribution, kind: str = "library") -> dict[str, Any]:
    """Describe a package, with the libraries and weights in it, and the bills that its wheel brings (PEP 770)."""
    component: dict[str, Any] = {
        "type": kind,
        "bom-ref": _url(package),
        "name": _metadata(package)["Name"],
        "version": _metadata(package)["Version"],
        "purl": _url(package),
    }
    if summary := _metadata(package).json.get("summary"):
        component["description"] = summary
    if licences := _licences(package):
        component["licenses"] = licences
    files = package.files or []
    if bills := [str(path) for path in files if "sboms" in path.parts and path.suffix == ".json"]:
        component["externalReferences"] = [{"type": "bom", "url": path} for path in bills]
    if carried := list(_carried_files(component["bom-ref"], files)):
        component["components"] = carried
    return component


def _carried_files(owner: str, files: Sequence[PackagePath]) -> Iterator[dict[str, Any]]:
    """Describe shared libraries of other projects, which the name of the package does not tell, and weights."""
    for path in sorted(files):
        is_model = path.suffix == ".onnx"
        if path.hash is not None and (is_model or _SHARED_LIBRARY.match(path.name)):
            yield {
                "type": "machine-learning-model" if is_model else "file",
                "bom-ref": f"{owner}#{path}",
                "name": str(path),
                "hashes": [{"alg": "SHA-256", "content": _hexadecimal(path.hash.value)}],
            }


def _hexadecimal(record: str) -> str:
    """Read a hash as the file RECORD writes it: base64 for URLs, without its padding."""
    return base64.urlsafe_b64decode(record + "=" * (-len(record) % 4)).hex()


def _licences(package: Distribution) -> list[dict[str, Any]]:
    stated = _metadata(package).json
    if "license_expression" in stated:
        return [{"expression": stated["license_expression"]}]
    names = [
        line.rpartition(" :: ")[2]
        for line in stated.get("classifier", ())
        if line.startswith("License :: ") and line != "License :: OSI Approved"
    ]
    if not names:
        text = str(stated.get("license", "UNKNOWN")).strip()
        lines = (_licence_file(package) if text == "UNKNOWN" else text).split("\n")
        # Of a whole licence the first two lines are its name and its version.
        title = [line.strip() for line in lines if line.strip()][:2]
        names = [" ".join(title)] if title else []
    return [{"license": {"name": name}} for name in names]


def _licence_file(package: Distribution) -> str:
    """Read the licence that a wheel brings; empty where it brings none."""
    for path in package.files or ():
        if path.parts[0].endswith(".dist-info") and re.match("LICEN[CS]E|COPYING", path.name):
            return path.read_text()
    return ""


def _surroundings() -> Iterator[dict[str, Any]]:
    """Describe Python and the system, which a weakness may be in too."""
    python = platform.python_version()
    yield {
        "type": "platform",
        "bom-ref": "python",
        "name": platform.python_implementation(),
        "version": python,
    }
    try:
        system = platform.freedesktop_os_release()
    except OSError:
        return
    release = {"version": system["VERSION_ID"]} if "VERSION_ID" in system else {}
    yield {"type": "operating-system", "bom-ref": "system", "name": system["ID"], **release}


def _bundle_components(path: Path) -> Iterator[dict[str, Any]]:
    """Describe a bundle by the SHA-256 of its manifest, which names all its files, and its trunk."""
    archive = open_archive(path)
    raw = archive.read(MANIFEST, MAX_MANIFEST_BYTES)
    manifest = parse_manifest(raw, archive.where)
    digest, licence = hashlib.sha256(raw).hexdigest(), licence_of(manifest)
    bundle: dict[str, Any] = {
        "type": "machine-learning-model",
        "bom-ref": f"bundle:{digest}",
        "name": f"{manifest.part}/{manifest.position}",
        "description": f"bundle of the method {manifest.method}",
        "hashes": [{"alg": "SHA-256", "content": digest}],
    }
    if manifest.revision is not None:
        bundle["version"] = str(manifest.revision)
    if licence is not None:
        bundle["licenses"] = [{"license": {"name": licence}}]
    yield bundle
    if manifest.backbone is not None:
        trunk = manifest.backbone.trunk.sha256
        yield {
            "type": "machine-learning-model",
            "bom-ref": f"trunk:{trunk}",
            "name": manifest.backbone.id,
            "description": "trunk",
            "hashes": [{"alg": "SHA-256", "content": trunk}],
        }


def _needs(package: Distribution) -> Iterator[str]:
    """Name what a package needs; of gelgate the extras too, as they are there where they are installed."""
    for line in _metadata(package).get_all("Requires-Dist") or ():
        name, _, marker = line.partition(";")
        if "extra" not in marker or _name(package) == "gelgate":
            yield _normal(re.split(r"[^A-Za-z0-9._-]", name.strip(), maxsplit=1)[0])


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _url(package: Distribution) -> str:
    return f"pkg:pypi/{_name(package)}@{_metadata(package)['Version']}"


def _name(package: Distribution) -> str:
    return _normal(_metadata(package)["Name"])


@cache
def _metadata(package: Distribution) -> PackageMetadata:
    """Read it once: Python parses the whole file, its README too, for each question."""
    return package.metadata
