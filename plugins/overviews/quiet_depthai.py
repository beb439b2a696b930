"""`depthai`, imported so that it sends nothing by itself: a gateway sends only what its configuration says.

Ref: the environment variables that depthai 3.12 reads. Since 3.7.1 it sends telemetry unless it is switched off.
"""

import os
from typing import Any, Final

from edge.extras import needs

__all__ = ["QUIET", "quiet_depthai"]

QUIET: Final = {
    "DEPTHAI_TELEMETRY": "0",
    "DEPTHAI_DISABLE_CRASHDUMP_COLLECTION": "1",
    "DEPTHAI_CRASHDUMP": "0",
    "DEPTHAI_DISABLE_FEEDBACK": "1",
    "DEPTHAI_DISABLE_STARTUP_NOTIFICATIONS": "1",
    "DEPTHAI_ZOO_INTERNET_CHECK": "0",
    # Milliseconds that it looks for a device that vanished between search and opening; 10 s by default.
    "DEPTHAI_SEARCH_TIMEOUT": "1000",
    # Its handlers end the process at a file that may not grow, which Python reports as an error, and print to it.
    "DEPTHAI_INSTALL_SIGNAL_HANDLER": "0",
    # Its warnings go to the standard output, where results of verbs go.
    "DEPTHAI_LEVEL": "error",
}


def quiet_depthai() -> Any:
    """The module. It reads these variables when it is imported. Errors: ConfigError where it is not installed."""
    needs("oak", "the overview camera 'oak'")
    os.environ.update(QUIET)
    import depthai

    return depthai
