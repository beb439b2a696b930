"""An OPC UA server for the handshake with a PLC, with the words of OPC 40100-1 (Machine Vision).

Ref: OPC 40100-1 V1.00, VisionStateMachineType, VisionAutomaticModeStateMachineType, ResultManagementType; asyncua 2.1.

What it does not do: its nodes have the standard's browse names in a namespace of our own and are no instances of its
types, for asyncua brings no nodes of the standard. It has no recipes to download, no configurations, no events, and
no results of before: a job's recipe is the name of a part. No login, no encryption.
"""

import asyncio
import logging
import socket
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from contextvars import ContextVar
from datetime import UTC, datetime
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any, Final

from pydantic import BaseModel, Field

from edge.core.errors import ConfigError
from edge.core.handshake import Code, Handshake, HandshakeView, Refusal, Trigger
from edge.core.plugins import HandshakePlugin
from edge.core.ports import Clock
from edge.core.rate import Rate
from edge.extras import needs
from plugins.handshakes.nodes import METHODS, NAMESPACE, STATUS, VARIABLES

if TYPE_CHECKING:
    from asyncua import Server


__all__ = ["OpcUa", "OpcUaOptions", "OpcUaServer", "plugin"]

log = logging.getLogger(__name__)

# Who calls methods keeps that right while its session asks anything, and this long after.
WRITER_S: Final = 3.0
# Subscriptions are told of changes this often; whoever reads gets the value of that moment.
PUSH_S: Final = 0.02
# One more takes the place of the one that is silent longest: that of a pulled cable is never ended otherwise.
MOST_CONNECTIONS: Final = 32
# Whoever connects again and again, such as a scanner, does not fill the log.
LINES_PER_MINUTE: Final = 6

_caller: ContextVar[Any] = ContextVar("session")


class OpcUaOptions(BaseModel, extra="forbid", frozen=True):
    """Where a PLC finds the nodes of plc.md. Needs the extra `opcua`. Whoever reaches the port can ask for everything
    there."""

    host: str = Field(
        default="127.0.0.1",
        min_length=1,
        description="the address of this machine at which the PLC asks; by default this machine alone",
    )
    port: int = Field(default=4840, ge=1, le=65535, description="TCP port")


class OpcUaServer:
    """A `HandshakeServer`, on a thread with a loop of its own. Errors: OSError for a port that cannot be taken."""

    def __init__(self, host: str, port: int, clock: Clock) -> None:
        self._clock = clock
        self._lines = Rate(LINES_PER_MINUTE, clock)
        self._held = _listen(host, port)  # until it serves
        self._address: tuple[str, int] = self._held.getsockname()[:2]
        self.name = "OPC UA at opc.tcp://{}:{}".format(*self._address)
        self._handshake: Handshake | None = None
        self._view: HandshakeView | None = None
        self._writer: Any = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing = asyncio.Event()
        self._nodes: dict[str, Any] = {}
        self._pushed: dict[str, Any] = {}
        self._has_begun, self._fault = threading.Event(), ""
        self._thread = threading.Thread(target=self._run, name="opcua", daemon=True)

    @property
    def has_ended(self) -> bool:
        return self._thread.ident is not None and not self._thread.is_alive()

    def start(self, handshake: Handshake) -> None:
        """Serve when it returns, which takes a second or two. Errors: ConfigError."""
        self._handshake = handshake
        self._thread.start()
        self._has_begun.wait()
        if self._fault:
            raise ConfigError(f"{self.name} cannot be served: {self._fault}; see the log")

    def close(self) -> None:
        self._held.close()
        if self._thread.is_alive() and self._loop is not None:
            self._loop.call_soon_threadsafe(self._closing.set)
            self._thread.join()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except Exception as error:
            self._fault = repr(error)
            log.exception("%s has ended", self.name)
        finally:
            self._has_begun.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        server = await self._build()
        self._held.close()
        await server.start()
        self._has_begun.set()
        try:
            while not self._closing.is_set():
                await self._push(server)
                _make_place(server, self._lines)
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._closing.wait(), PUSH_S)
        finally:
            await server.stop()

    async def _build(self) -> "Server":
        """Make the server and its nodes; nothing is served yet."""
        from asyncua import Server, ua

        logging.getLogger("asyncua").setLevel(logging.ERROR)  # it logs every request
        server = Server()
        await server.init()
        server.set_endpoint("opc.tcp://{}:{}".format(*self._address))
        server.set_server_name("gelgate")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        server.allow_remote_admin(False)  # else who says that he is "admin" may write and remove every node
        server.iserver.max_connections = 2 * MOST_CONNECTIONS  # those that come between two looks
        _note_callers(server, self._clock)
        space = await server.register_namespace(NAMESPACE)
        root = await server.nodes.objects.add_object(f"ns={space};s=VisionSystem", f"{space}:VisionSystem")
        folders = {"": root}

        async def make_place(path: str) -> tuple[Any, str, str]:
            """Return the folder of a node, its id and its browse name; make the folders above."""
            above, _, name = path.rpartition("/")
            if above not in folders:
                folder, node_id, browse_name = await make_place(above)
                folders[above] = await folder.add_object(node_id, browse_name)
            return folders[above], f"ns={space};s=VisionSystem/{path}", f"{space}:{name}"

        for path, (kind, _, _) in VARIABLES.items():
            folder, node_id, browse_name = await make_place(path)
            empty = {"String": "", "Boolean": False, "Double": 0.0}.get(kind, 0)
            node = await folder.add_variable(node_id, browse_name, empty, ua.VariantType[kind])
            self._nodes[path] = node.nodeid
            server.set_attribute_value_callback(node.nodeid, partial(self._answer, path))
        for path, (given, _) in METHODS.items():
            folder, node_id, browse_name = await make_place(path)
            call = partial(self._call, path.rpartition("/")[2])
            await folder.add_method(node_id, browse_name, _method(call), _arguments(given), [])
        return server

    def _seen(self) -> HandshakeView:
        """Return what a PLC sees: of one moment for all nodes of one request, which is read without a pause."""
        assert self._handshake is not None  # set by `start`
        assert self._loop is not None
        if self._view is None:
            self._view = self._handshake.read()
            self._loop.call_soon(self._forget)
        return self._view

    def _forget(self) -> None:
        self._view = None

    def _answer(self, path: str, *asked: object) -> Any:
        from asyncua import ua

        kind, _, value = VARIABLES[path]
        variant = ua.Variant(value(self._seen()), ua.VariantType[kind])
        return ua.DataValue(variant, SourceTimestamp=datetime.now(UTC))

    async def _push(self, server: "Server") -> None:
        """Tell subscriptions what has changed."""
        for path, node_id in self._nodes.items():
            value = self._answer(path)
            if self._pushed.get(path) != value.Value:
                self._pushed[path] = value.Value
                await server.write_attribute_value(node_id, value)
                server.set_attribute_value_callback(node_id, partial(self._answer, path))

    async def _call(self, method: str, *given: Any) -> Any:
        """Do what a session asks for; returns a status code."""
        from asyncua import ua

        assert self._handshake is not None
        self._view = None  # a request that comes behind this one, at once, sees what it has done
        if (sentence := self._refuse_writer()) is not None:
            self._handshake.refuse("write", sentence)
            return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
        match method:
            case "StartSingleJob":
                return _status(_start(self._handshake, given))
            case "Beat":
                self._handshake.beat()
            case "Abort" | "Acknowledge":
                self._handshake.acknowledge()
        return ua.StatusCode()

    def _refuse_writer(self) -> str | None:
        """Let one session call methods at a time; return why this one may not."""
        session, writer = _caller.get(), self._writer
        is_other = writer is not None and writer is not session and writer.is_activated()
        # asyncua keeps a session that is not heard any more for its time-out
        if is_other and self._clock.monotonic_ns() - writer.heard_ns <= WRITER_S * 1e9:
            return (
                f"a second client, {_address(session)}, calls a method while {_address(writer)} does; it may read, and "
                f"call {WRITER_S:g} s after the other's last request"
            )
        self._writer = session
        return None


def _address(session: Any) -> str:
    """Return where its client is: asyncua names a session by the address of its socket."""
    return "{}:{}".format(*session.name[:2])


def _listen(host: str, port: int) -> socket.socket:
    """Take the port. Errors: OSError."""
    held = socket.socket()
    try:
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind((host, port))
        held.listen()
    except OSError:
        held.close()
        raise
    return held


def _start(handshake: Handshake, arguments: tuple[Any, ...]) -> Refusal | None:
    match arguments:
        case (int() as number, str() | None as piece, str() | None as part) if type(number) is int:
            return handshake.trigger(Trigger(number, piece or "", part or ""))
    sentence = (
        f"StartSingleJob is called with {arguments!r:.120}, expected a number and two texts; see docs/plc.md"
    )
    handshake.refuse("trigger", sentence)
    return Refusal(Code.BAD_VALUE, sentence)


def _status(refusal: Refusal | None) -> Any:
    from asyncua import ua

    name = "Good" if refusal is None else STATUS.get(refusal.code, "BadInvalidState")
    return ua.StatusCode(getattr(ua.StatusCodes, name))


def _method(call: Callable[..., Any]) -> Callable[..., Any]:
    """Return what asyncua calls: a coroutine function, so that it runs where the session is known."""

    async def called(parent: object, *arguments: Any) -> Any:
        return await call(*(argument.Value for argument in arguments))

    return called


def _arguments(types: Mapping[str, str]) -> list[Any]:
    from asyncua import ua

    return [
        ua.Argument(Name=name, DataType=ua.NodeId(getattr(ua.ObjectIds, kind)), ValueRank=-1)
        for name, kind in types.items()
    ]


def _note_callers(server: "Server", clock: Clock) -> None:
    """Let a method know which session calls it, and each session when it was heard: asyncua does not say."""
    create = server.iserver.create_session

    def create_session(*arguments: Any, **options: Any) -> Any:
        session = create(*arguments, **options)
        call, touch = session.call, session.touch

        def hear() -> None:
            touch()
            session.heard_ns = clock.monotonic_ns()

        async def noted(*arguments: Any) -> Any:
            _caller.set(session)
            return await call(*arguments)

        session.call, session.touch = noted, hear
        return session

    server.iserver.create_session = create_session


def _make_place(server: "Server", lines: Rate) -> None:
    """End what is silent longest, where more than so many connections are open."""
    clients = server.bserver.clients
    silent = sorted(clients, key=lambda client: client.processor.session_last_activity or inf)
    for client in silent[: max(0, len(clients) - MOST_CONNECTIONS)]:
        if lines.take():
            log.warning(
                "more than %d connections are open; %s, silent longest, is ended",
                MOST_CONNECTIONS,
                client.peer_name,
            )
        client.transport.abort()  # what it has not taken it never will


class OpcUa(HandshakePlugin[OpcUaOptions]):
    """The plugin."""

    Options = OpcUaOptions

    def open(self, options: OpcUaOptions, clock: Clock) -> OpcUaServer:
        needs("opcua", 'handshake.plugin = "opcua"')
        try:
            return OpcUaServer(options.host, options.port, clock)
        except OSError as error:
            raise ConfigError(
                f"handshake.options: {options.host}:{options.port} cannot be served ({error.strerror or error}); "
                "choose another port or an address of this machine, or end what uses it"
            ) from error


plugin = OpcUa()
