"""A PLC at the nodes of a station, with asyncua's client."""

import re
from typing import Any

from plugins.handshakes.nodes import METHODS, NAMESPACE, VARIABLES

JOBS = "VisionStateMachine/AutomaticModeStateMachine"
RESULT = "ResultManagement/LatestResult"
# Of an answer, and between two looks whether the server lives: so long that a busy machine cuts no connection.
PATIENCE_S = 120


class OpcUaPlc:
    """One session. user: the name that it gives."""

    def __init__(self, address: str, user: str | None = None) -> None:
        from asyncua.sync import Client

        self.client: Any = Client(address, timeout=PATIENCE_S, watchdog_intervall=PATIENCE_S)
        if user is not None:
            self.client.set_user(user)
        try:
            self.client.connect()
        except Exception:
            self.close()  # its thread would keep the program from its end
            raise
        self.space = self.client.get_namespace_index(NAMESPACE)

    def node(self, path: str) -> Any:
        return self.client.get_node(f"ns={self.space};s=VisionSystem/{path}")

    def read(self) -> dict[str, Any]:
        """All variables, by the last part of their path but for the states: one request, so one moment."""
        names = [re.sub(".*/(?=[^/]+/CurrentState)|.*/(?!CurrentState)", "", path) for path in VARIABLES]
        values = self.client.read_values([self.node(path) for path in VARIABLES])
        return dict(zip(names, values, strict=True))

    def call(self, path: str, *arguments: Any) -> str:
        """Call a method; return the name of its status code."""
        from asyncua import ua

        assert path in METHODS
        above = path.rpartition("/")[0]
        try:
            self.node(above).call_method(self.node(path), *arguments)
        except ua.UaStatusCodeError as error:
            return ua.status_codes.get_name_and_doc(error.code)[0]
        return "Good"

    def start_job(self, job_id: int, piece: str = "", recipe: str = "") -> str:
        from asyncua import ua

        return self.call(f"{JOBS}/StartSingleJob", ua.Variant(job_id, ua.VariantType.UInt32), piece, recipe)

    def acknowledge(self) -> str:
        return self.call("ResultManagement/Acknowledge")

    def beat(self) -> str:
        return self.call("Station/Beat")

    def cut(self) -> None:
        """End the connection without a farewell: the session stays open."""
        self.client.tloop.loop.call_soon_threadsafe(self.client.aio_obj.uaclient.protocol.transport.abort)

    def close(self) -> None:
        client, self.client = self.client, None
        if client is not None:
            client.disconnect()
