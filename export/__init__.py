"""Trained models into the gateway, and bundles out of it, from Python.

    from export import BackboneOptions, export_backbone
    export_backbone(Path("wide_resnet50_2-95faca4d.pth"), Path("trunk.onnx"), BackboneOptions(licence="BSD-3-Clause"))

Names are loaded at use: importing this package imports neither onnx nor torch. docs/export.md has the whole way.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from export.backbone import BackboneExport, BackboneOptions, export_backbone
    from export.bundle_stages import bundle_stages, compared_with
    from export.external_graph import WrapConfig, wrap_files
    from export.importers.api import (
        ImportedBundle,
        ImportOptions,
        import_detector,
        import_fapm,
        import_inreach,
        import_padim,
        import_patchcore,
        import_spade,
    )
    from export.merge import merge_bundle, merged_graph
    from export.openvino_model import write_openvino
    from export.parity import ParityReport, Stage, compare, order_stage
    from export.precision import chosen, in_precision, measured
    from export.single_graph import Adapted, GraphInput, adapted

_HOMES = {
    "backbone": ("BackboneExport", "BackboneOptions", "export_backbone"),
    "bundle_stages": ("bundle_stages", "compared_with"),
    "external_graph": ("WrapConfig", "wrap_files"),
    "importers.api": (
        "ImportOptions",
        "ImportedBundle",
        "import_detector",
        "import_fapm",
        "import_inreach",
        "import_padim",
        "import_patchcore",
        "import_spade",
    ),
    "merge": ("merge_bundle", "merged_graph"),
    "openvino_model": ("write_openvino",),
    "parity": ("ParityReport", "Stage", "compare", "order_stage"),
    "precision": ("chosen", "in_precision", "measured"),
    "single_graph": ("Adapted", "GraphInput", "adapted"),
}

__all__ = [
    "Adapted",
    "BackboneExport",
    "BackboneOptions",
    "GraphInput",
    "ImportOptions",
    "ImportedBundle",
    "ParityReport",
    "Stage",
    "WrapConfig",
    "adapted",
    "bundle_stages",
    "chosen",
    "compare",
    "compared_with",
    "export_backbone",
    "import_detector",
    "import_fapm",
    "import_inreach",
    "import_padim",
    "import_patchcore",
    "import_spade",
    "in_precision",
    "measured",
    "merge_bundle",
    "merged_graph",
    "order_stage",
    "wrap_files",
    "write_openvino",
]


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"export.{module}"), name)
    raise AttributeError(f"export has no '{name}'; it has {', '.join(__all__)}")
