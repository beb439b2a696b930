"""The OPC UA server, asked by node-opcua. Run by `make test-subscribers`, which installs it."""

import contextlib
import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from handshake_bench import Bench, BenchHandshake
from opcua_plc import JOBS, RESULT

from edge.clock import SystemClock
from edge.core.handshake import Trigger
from plugins.handshakes.nodes import NAMESPACE, VARIABLES
from plugins.handshakes.opcua import OpcUaServer

pytestmark = pytest.mark.subscribers

INSTALLED = Path(os.environ.get("GELGATE_SUBSCRIBERS", ".venv-subscribers")).absolute()

# One request a line, one answer a line. The program ends with its input.
PROGRAM = """
const say = console.log;
console.log = console.error;  // the library's own words
const { OPCUAClient, DataType, AttributeIds } = require("node-opcua-client");
(async () => {
  const client = OPCUAClient.create({ endpointMustExist: false, connectionStrategy: { maxRetry: 1 } });
  await client.connect(process.argv[2]);
  const session = await client.createSession();
  const space = (await session.readNamespaceArray()).indexOf(process.argv[3]);
  const node = (path) => `ns=${space};s=VisionSystem/${path}`;
  // made here: what comes before someone takes lines is lost
  for await (const line of require("readline").createInterface({ input: process.stdin })) {
    const { read, call, given } = JSON.parse(line);
    if (read) {
      const found = await session.read(read.map((path) => ({ nodeId: node(path), attributeId: AttributeIds.Value })));
      say(JSON.stringify(found.map((one) => one.value.value)));
    } else {
      const done = await session.call({
        objectId: node(call.replace(/[/][^/]*$/, "")),
        methodId: node(call),
        inputArguments: given.map(([type, value]) => ({ dataType: DataType[type], value })),
      });
      say(JSON.stringify(done.statusCode.name));
    }
  }
  await session.close();
  await client.disconnect();
})().catch((error) => { console.error(error); process.exit(1); });
"""

Ask = Callable[..., Any]


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def handshake(bench: Bench) -> BenchHandshake:
    return BenchHandshake(bench)


@pytest.fixture
def ask(handshake: BenchHandshake, tmp_path: Path) -> Iterator[Ask]:
    """A session of node-opcua."""
    if not (INSTALLED / "node_modules/node-opcua-client").is_dir() or shutil.which("node") is None:
        pytest.skip(f"SKIPPED, NOT TESTED: node-opcua-client is not installed in {INSTALLED}")
    server = OpcUaServer("127.0.0.1", 0, SystemClock())
    with contextlib.closing(server):
        server.start(handshake)
        with subprocess.Popen(
            ["node", "-e", PROGRAM, "plc", server.name.rpartition(" ")[2], NAMESPACE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=INSTALLED,
            env=os.environ | {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)},
        ) as program:

            def answer(**request: Any) -> Any:
                assert program.stdin is not None
                assert program.stdout is not None
                print(json.dumps(request), file=program.stdin, flush=True)
                return json.loads(program.stdout.readline())

            yield answer
            program.communicate(timeout=20)
            assert program.returncode == 0


def test_a_job_from_its_start_to_the_next(ask: Ask, bench: Bench, handshake: BenchHandshake) -> None:
    """The nodes are read, the methods called; a job that is refused has its status code, and one gets its result."""

    def start(job_id: int) -> str:
        given = [["UInt32", job_id], ["String", "piece 17"], ["String", ""]]
        return str(ask(call=f"{JOBS}/StartSingleJob", given=given))

    result = [f"{RESULT}/{name}" for name in ("JobId", "PartId", "IsAvailable", "IsPass", "IsNotPassed")]
    assert len(ask(read=list(VARIABLES))) == len(VARIABLES)
    assert ask(read=[f"{JOBS}/CurrentState"]) == ["Ready"]
    assert ask(call="Station/Beat", given=[]) == "Good"
    assert start(70_000) == "Good"
    assert handshake.taken == [Trigger(70_000, "piece 17", "")]
    assert start(70_001) == "BadInvalidState"
    assert ask(read=[f"{JOBS}/CurrentState", *result]) == [
        "SingleExecution", 70_000, "piece 17", False, False, True,
    ]  # fmt: skip
    bench.press("pass")
    assert ask(read=result) == [70_000, "piece 17", True, True, False]
    assert ask(call="ResultManagement/Acknowledge", given=[]) == "Good"
    assert start(70_000) == "BadEntryExists"
    assert ask(read=[f"{JOBS}/CurrentState", *result]) == ["Ready", 0, "", False, False, True]
