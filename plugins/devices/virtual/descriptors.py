"""The descriptors that a GelSight Mini and its webcam siblings show on the bus, built byte by byte.

Ref: USB 2.0 chapter 9; UVC 1.0 chapter 3. firmware_notes/gelsight_mini.md says what is known of the real descriptors.
Ids, strings, speed, power, the two interfaces and the one video mode were read in public dumps. Terminals, controls,
endpoints and alternate settings are the usual ones of boards with this bridge.
"""

import struct
from dataclasses import dataclass
from types import SimpleNamespace

from plugins.devices.uvc.identity import PRODUCT_ID, VENDOR_ID
from plugins.devices.uvc.uvc import CLASS_VIDEO, SUBCLASS_CONTROL, SUBCLASS_STREAMING, UNITS_PER_SECOND

__all__ = [
    "ALTERNATE_PACKETS",
    "CONTROL_INTERFACE",
    "STREAMING_ENDPOINT",
    "STREAMING_INTERFACE",
    "WEBCAM",
    "Board",
    "configuration_descriptor",
    "device_descriptor",
    "endpoint_descriptor",
    "interface_descriptor",
    "string_descriptor",
]

CONTROL_INTERFACE, STREAMING_INTERFACE = 0, 1
STATUS_ENDPOINT, STREAMING_ENDPOINT = 0x83, 0x81
# wMaxPacketSize of alternate settings 0 to 7: bytes, and how many more transactions in bits 11-12; up to 3 x 1024.
ALTERNATE_PACKETS = (0, 0x0080, 0x0200, 0x0400, 0x0B00, 0x0C00, 0x1380, 0x1400)
HIGH_SPEED = 3
CAMERA_TERMINAL, PROCESSING_UNIT, OUTPUT_TERMINAL = 1, 2, 3
US_ENGLISH = 0x0409


@dataclass(frozen=True)
class Board:
    """One camera board: its strings and its MJPEG modes as (width, height, nominal fps)."""

    product: str
    serial: str
    modes: tuple[tuple[int, int, float], ...]
    manufacturer: str = "Arducam Technology Co., Ltd."

    @property
    def strings(self) -> tuple[str, ...]:
        """The strings in the order of their index, from 1."""
        return (self.manufacturer, self.product, self.serial)

    @staticmethod
    def max_frame_bytes(width: int, height: int) -> int:
        """Two bytes per pixel, the usual limit of these boards for MJPEG."""
        return width * height * 2


# The Arducam B0268 board has the same USB id; modes as measured publicly on one.
WEBCAM = Board(
    "USB 2.0 Camera",
    "SN0001",
    ((320, 240, 30), (640, 480, 30), (1280, 720, 30), (1600, 1200, 30), (1920, 1080, 30)),
)


def device_descriptor(*, bus: int, address: int, port: int) -> SimpleNamespace:
    """The 14 fields of the device descriptor, and the device's place on the bus."""
    return SimpleNamespace(
        bLength=18,
        bDescriptorType=1,
        bcdUSB=0x0200,
        bDeviceClass=0xEF,  # miscellaneous, with an interface association
        bDeviceSubClass=2,
        bDeviceProtocol=1,
        bMaxPacketSize0=64,
        idVendor=VENDOR_ID,
        idProduct=PRODUCT_ID,
        bcdDevice=0x0100,
        iManufacturer=1,
        iProduct=2,
        iSerialNumber=3,
        bNumConfigurations=1,
        bus=bus,
        address=address,
        port_number=port,
        port_numbers=(port,),
        speed=HIGH_SPEED,
    )


def configuration_descriptor(board: Board, index: int) -> SimpleNamespace:
    """The one configuration: 500 mA, two associated interfaces."""
    if index != 0:
        raise IndexError(f"configuration {index}")
    association = bytes((8, 0x0B, CONTROL_INTERFACE, 2, CLASS_VIDEO, 3, 0, 2))
    streaming = sum(16 for packet in ALTERNATE_PACKETS if packet) + 9
    total = (
        9 + len(association) + 9 + len(_control_extra()) + 7 + 5 + streaming + len(_streaming_extra(board))
    )
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=2,
        wTotalLength=total,
        bNumInterfaces=2,
        bConfigurationValue=1,
        iConfiguration=0,
        bmAttributes=0x80,
        bMaxPower=250,  # in 2 mA
        extra_descriptors=association,
    )


def interface_descriptor(board: Board, interface: int, alternate: int) -> SimpleNamespace:
    """Interface by index. Errors: IndexError past the last one, which ends pyusb's iteration."""
    if interface == CONTROL_INTERFACE and alternate == 0:
        return _interface(interface, 0, SUBCLASS_CONTROL, 1, _control_extra())
    if interface == STREAMING_INTERFACE and alternate < len(ALTERNATE_PACKETS):
        extra = _streaming_extra(board) if alternate == 0 else b""
        return _interface(interface, alternate, SUBCLASS_STREAMING, 1 if alternate else 0, extra)
    raise IndexError(f"interface {interface}, alternate setting {alternate}")


def _interface(number: int, alternate: int, subclass: int, endpoints: int, extra: bytes) -> SimpleNamespace:
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=4,
        bInterfaceNumber=number,
        bAlternateSetting=alternate,
        bNumEndpoints=endpoints,
        bInterfaceClass=CLASS_VIDEO,
        bInterfaceSubClass=subclass,
        bInterfaceProtocol=0,
        iInterface=2 if number == CONTROL_INTERFACE else 0,
        extra_descriptors=extra,
    )


def endpoint_descriptor(endpoint: int, interface: int, alternate: int) -> SimpleNamespace:
    """The status endpoint of the control interface, or the isochronous one of an alternate setting."""
    if endpoint != 0 or (interface == STREAMING_INTERFACE and alternate == 0):
        raise IndexError(f"endpoint {endpoint} of interface {interface}, alternate setting {alternate}")
    if interface == CONTROL_INTERFACE:
        return _endpoint(STATUS_ENDPOINT, 0x03, 16, 6, bytes((5, 0x25, 0x03, 16, 0)))
    return _endpoint(STREAMING_ENDPOINT, 0x05, ALTERNATE_PACKETS[alternate], 1, b"")


def _endpoint(address: int, attributes: int, max_packet: int, interval: int, extra: bytes) -> SimpleNamespace:
    return SimpleNamespace(
        bLength=7,
        bDescriptorType=5,
        bEndpointAddress=address,
        bmAttributes=attributes,
        wMaxPacketSize=max_packet,
        bInterval=interval,
        bRefresh=0,
        bSynchAddress=0,
        extra_descriptors=extra,
    )


def string_descriptor(board: Board, index: int) -> bytes:
    """Index 0 lists the languages; the others are UTF-16LE texts. Errors: IndexError for an unknown index."""
    if index == 0:
        body = struct.pack("<H", US_ENGLISH)
    elif index <= len(board.strings):
        body = board.strings[index - 1].encode("utf-16-le")
    else:
        raise IndexError(f"string {index}")
    return bytes((2 + len(body), 3)) + body


def _control_extra() -> bytes:
    """Camera terminal, processing unit and output terminal in a row, and the header over them."""
    terminal = struct.pack("<BBBBHBBHHHB", 18, 0x24, 0x02, CAMERA_TERMINAL, 0x0201, 0, 0, 0, 0, 0, 3)
    terminal += (0x0A | 0x04).to_bytes(3, "little")  # exposure mode, priority and absolute time
    unit = struct.pack("<BBBBBHB", 11, 0x24, 0x05, PROCESSING_UNIT, CAMERA_TERMINAL, 0, 2)
    unit += (0x177F).to_bytes(
        2, "little"
    ) + b"\0"  # brightness to backlight, gain, power line, white balance auto
    output = struct.pack("<BBBBHBBB", 9, 0x24, 0x03, OUTPUT_TERMINAL, 0x0101, 0, PROCESSING_UNIT, 0)
    body = terminal + unit + output
    header = struct.pack(
        "<BBBHHIBB", 13, 0x24, 0x01, 0x0100, 13 + len(body), 30_000_000, 1, STREAMING_INTERFACE
    )
    return header + body


def _streaming_extra(board: Board) -> bytes:
    """Input header, one MJPEG format, a frame descriptor per mode, and the colours (sRGB)."""
    frames = b"".join(_frame(index, *mode) for index, mode in enumerate(board.modes, start=1))
    format_ = struct.pack("<BBBBBBBBBBB", 11, 0x24, 0x06, 1, len(board.modes), 1, 1, 0, 0, 0, 0)
    colours = bytes((6, 0x24, 0x0D, 1, 1, 4))
    body = format_ + frames + colours
    header = struct.pack(
        "<BBBBHBBBBBBBB",
        14,
        0x24,
        0x01,
        1,
        14 + len(body),
        STREAMING_ENDPOINT,
        0,
        OUTPUT_TERMINAL,
        0,
        0,
        0,
        1,
        0,
    )
    return header + body


def _frame(index: int, width: int, height: int, fps: float) -> bytes:
    longest = Board.max_frame_bytes(width, height)
    interval = round(UNITS_PER_SECOND / fps)
    rate = min(int(longest * 8 * fps), 0xFFFFFFFF)
    return struct.pack(
        "<BBBBBHHIIIIBI", 30, 0x24, 0x07, index, 0, width, height, rate, rate, longest, interval, 1, interval
    )
