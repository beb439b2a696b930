"""The virtual bus: pyusb's backend interface over virtual cameras, plugging and unplugging included.

Ref: pyusb 1.3.1, usb/backend/__init__.py (what each method must answer); kernel-driver behaviour as observed with
uvcvideo on Linux 6.1: detaching the control interface releases the streaming interface with it, attaching it binds
both again, and attaching an interface that is bound says busy.
"""

import errno
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import usb.backend

from edge.core.ports import Clock
from plugins.devices.virtual import descriptors
from plugins.devices.virtual.camera import VirtualCamera, VirtualPacketStream, usb_error
from plugins.devices.virtual.descriptors import CONTROL_INTERFACE, STREAMING_INTERFACE

__all__ = ["Handle", "VirtualBus"]

BUS_NUMBER = 1


@dataclass(eq=False)
class Handle:
    """One opened device: invalid after its camera has left the bus, because no address is used twice."""

    camera: VirtualCamera
    address: int

    def live_camera(self) -> VirtualCamera:
        """Give the camera. Errors: USBError errno 19 when it has left the bus."""
        if not self.camera.is_present or self.camera.address != self.address:
            raise usb_error(errno.ENODEV)
        return self.camera


class VirtualBus(usb.backend.IBackend):  # type: ignore[misc]  # pyusb is untyped
    """A pyusb backend. Pass it as `backend=` to `usb.core.find`, or to `plugins.devices.uvc.stream.UvcSensor.open`."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock
        self._cameras: list[VirtualCamera] = []
        self._next_address = 2  # 1 is the root hub

    def plug_in(self, camera: VirtualCamera, *, port: int | None = None) -> None:
        """Connect a camera, at a new address, and at another port if one is given."""
        if camera not in self._cameras:
            self._cameras.append(camera)
        camera.plug_in(address=self._next_address, port=port)
        self._next_address += 1

    # pyusb's calls to the bus

    def enumerate_devices(self) -> Iterator[VirtualCamera]:
        for camera in self._cameras:
            if camera.wants_back:
                self.plug_in(camera)
            if camera.is_present:
                yield camera

    def get_parent(self, dev: VirtualCamera) -> None:
        return None

    def get_device_descriptor(self, dev: VirtualCamera) -> SimpleNamespace:
        return descriptors.device_descriptor(bus=BUS_NUMBER, address=dev.address, port=dev.port)

    def get_configuration_descriptor(self, dev: VirtualCamera, config: int) -> SimpleNamespace:
        return descriptors.configuration_descriptor(dev.board, config)

    def get_interface_descriptor(
        self, dev: VirtualCamera, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        return descriptors.interface_descriptor(dev.board, intf, alt)

    def get_endpoint_descriptor(
        self, dev: VirtualCamera, ep: int, intf: int, alt: int, config: int
    ) -> SimpleNamespace:
        return descriptors.endpoint_descriptor(ep, intf, alt)

    # pyusb's calls to an opened device

    def open_device(self, dev: VirtualCamera) -> Handle:
        if not dev.is_present:
            raise usb_error(errno.ENODEV)
        return Handle(dev, dev.address)

    def close_device(self, dev_handle: Handle) -> None:
        """The kernel takes the claimed interfaces back and stops the stream."""
        camera = dev_handle.camera
        if not camera.is_present or camera.address != dev_handle.address:
            return
        for interface in [claimed for claimed, holder in camera.claims.items() if holder is dev_handle]:
            self.release_interface(dev_handle, interface)

    def get_configuration(self, dev_handle: Handle) -> int:
        dev_handle.live_camera()
        return 1

    def set_configuration(self, dev_handle: Handle, config_value: int) -> None:
        camera = dev_handle.live_camera()
        if config_value != 1:
            raise usb_error(errno.ENOENT)
        if any(camera.kernel_driver.values()):
            raise usb_error(errno.EBUSY)

    def claim_interface(self, dev_handle: Handle, intf: int) -> None:
        camera = dev_handle.live_camera()
        if intf not in camera.kernel_driver:
            raise usb_error(errno.ENOENT)
        if camera.kernel_driver[intf] or camera.claims.get(intf, dev_handle) is not dev_handle:
            raise usb_error(errno.EBUSY)
        camera.claims[intf] = dev_handle

    def release_interface(self, dev_handle: Handle, intf: int) -> None:
        camera = dev_handle.live_camera()
        if camera.claims.get(intf) is not dev_handle:
            raise usb_error(errno.ENOENT)
        if intf == STREAMING_INTERFACE:
            camera.select(0)
        del camera.claims[intf]

    def set_interface_altsetting(self, dev_handle: Handle, intf: int, altsetting: int) -> None:
        camera = dev_handle.live_camera()
        if camera.claims.get(intf) is not dev_handle:
            raise usb_error(errno.ENOENT)
        if intf == STREAMING_INTERFACE:
            camera.select(altsetting)
        elif altsetting != 0:
            raise usb_error(errno.ENOENT)

    def ctrl_transfer(
        self,
        dev_handle: Handle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: Any,
        timeout: int,
    ) -> int:
        return dev_handle.live_camera().control(bmRequestType, bRequest, wValue, wIndex, data)

    def packet_stream(self, dev_handle: Handle, endpoint: int, packet_bytes: int) -> VirtualPacketStream:
        """Isochronous reads with separate packets (see `plugins.devices.uvc.stream.PacketBackend`)."""
        camera = dev_handle.live_camera()
        if (
            camera.claims.get(STREAMING_INTERFACE) is not dev_handle
            or endpoint != descriptors.STREAMING_ENDPOINT
        ):
            raise usb_error(errno.ENOENT)
        return VirtualPacketStream(camera, self._clock, packet_bytes)

    def reset_device(self, dev_handle: Handle) -> None:
        """A reset ends a stall; the kernel binds its driver again where no handle holds the interface."""
        camera = dev_handle.live_camera()
        camera.select(0)
        for interface in camera.kernel_driver:
            camera.kernel_driver[interface] = interface not in camera.claims

    # The kernel's driver

    def is_kernel_driver_active(self, dev_handle: Handle, intf: int) -> bool:
        return dev_handle.live_camera().kernel_driver.get(intf, False)

    def detach_kernel_driver(self, dev_handle: Handle, intf: int) -> None:
        camera = dev_handle.live_camera()
        if not camera.kernel_driver.get(intf, False):
            raise usb_error(errno.ENOENT)
        for interface in (CONTROL_INTERFACE, STREAMING_INTERFACE) if intf == CONTROL_INTERFACE else (intf,):
            camera.kernel_driver[interface] = False

    def attach_kernel_driver(self, dev_handle: Handle, intf: int) -> None:
        camera = dev_handle.live_camera()
        if camera.kernel_driver.get(intf, True) or camera.claims:
            raise usb_error(errno.EBUSY)
        for interface in (CONTROL_INTERFACE, STREAMING_INTERFACE) if intf == CONTROL_INTERFACE else (intf,):
            camera.kernel_driver[interface] = True
