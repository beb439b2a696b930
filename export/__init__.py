"""Trained models into the gateway, and bundles out of it, from Python.

    from export import BackboneOptions, export_backbone
    export_backbone(Path("wide_resnet50_2-95faca4d.pth"), Path("trunk.onnx"), BackboneOptions(licence="BSD-3-Clause"))

Names are loaded at use: importing this package imports neither onnx nor torch. docs/export.md has the whole way.
"""

from typing import TYPE_CHECKING, Any

import edge  # noqa: F401 - before onnxruntime

if TYPE_CHECKING:
    from export.backbone import BackboneExport, BackboneOptions, export_backbone
    from export.bundle_stages import compare_bundle
    from export.finish import WrapConfig, wrap_files
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
    from export.precision import choose_precision, in_precision, measure_precisions
    from export.single_graph import Adapted, GraphInput, adapt

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
    "adapt",
    "choose_precision",
    "compare",
    "compare_bundle",
    "export_backbone",
    "import_detector",
    "import_fapm",
    "import_inreach",
    "import_padim",
    "import_patchcore",
    "import_spade",
    "in_precision",
    "measure_precisions",
    "merge_bundle",
    "merged_graph",
    "order_stage",
    "wrap_files",
    "write_openvino",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"export has no '{name}'; it has {', '.join(__all__)}")
    from export import backbone, bundle_stages, finish, merge, openvino_model, parity, precision, single_graph
    from export.importers import api

    homes = (api, backbone, bundle_stages, finish, merge, openvino_model, parity, precision, single_graph)
    return next(getattr(home, name) for home in homes if hasattr(home, name))
