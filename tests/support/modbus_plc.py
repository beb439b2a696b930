"""A PLC at the registers of a station, with pymodbus' client."""

import struct

from pymodbus.client import ModbusTcpClient

from plugins.handshakes.registers import INPUTS, STATUS_BITS

TRIGGER, ACKNOWLEDGE, WATCHDOG = range(3)
HELD = sum(register.count for register in INPUTS)


class Plc:
    """What a PLC does, with pymodbus' client."""

    def __init__(self, port: int) -> None:
        self.client = ModbusTcpClient("127.0.0.1", port=port, timeout=5, retries=0)
        assert self.client.connect()

    def write_trigger(self, trigger_id: int, piece: str = "", part: str = "") -> bool:
        texts = (piece.encode("latin-1").ljust(32, b"\0"), part.encode("latin-1").ljust(32, b"\0"))
        words = [trigger_id >> 16, trigger_id & 0xFFFF]
        for text in texts:
            words += struct.unpack(">16H", text)
        return not self.client.write_registers(0, words).isError()

    def write(self, coil: int, is_on: bool) -> int:
        """Write a coil; return the exception code, 0 for none."""
        answer = self.client.write_coil(coil, is_on)
        return answer.exception_code if answer.isError() else 0

    def trigger(self, trigger_id: int, piece: str = "", part: str = "") -> int:
        self.write_trigger(trigger_id, piece, part)
        return self.write(TRIGGER, False) or self.write(TRIGGER, True)

    @property
    def bits(self) -> set[str]:
        """The names of the discrete inputs that are on."""
        bits = self.client.read_discrete_inputs(0, count=len(STATUS_BITS)).bits
        return {name for (name, _, _), bit in zip(STATUS_BITS, bits, strict=False) if bit}

    @property
    def words(self) -> list[int]:
        words = self.client.read_input_registers(0, count=HELD).registers
        names = {name for bit, (name, _, _) in enumerate(STATUS_BITS) if words[0] >> bit & 1}
        assert names == self.bits, "the status word and the discrete inputs"
        return list(words)

    def close(self) -> None:
        self.client.close()
