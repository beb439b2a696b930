"""gelgate, the gateway: from a press of the sensor to a verdict that the plant can subscribe to."""

import os

# onnxruntime writes a device id and reports to its maker, unless this is set before it is imported: what imports it,
# imports this package first.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
