"""The configuration: one TOML file, read once into frozen values, all faults reported together.

Paths are relative to the file. Plugin options are validated by the plugin's own `Options` model, in the same report.
"""

from edge.config.feature_tables import OverviewTable
from edge.config.loading import load_config, root_options, sink_names
from edge.config.plugin_tables import ActuatorTable, HandshakeTable, PluginTable, TriggerTable
from edge.config.tables import BundleTable, Config, ContactTable, InspectionTable

__all__ = [
    "ActuatorTable",
    "BundleTable",
    "Config",
    "ContactTable",
    "HandshakeTable",
    "InspectionTable",
    "OverviewTable",
    "PluginTable",
    "TriggerTable",
    "load_config",
    "root_options",
    "sink_names",
]
