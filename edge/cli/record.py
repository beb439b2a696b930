"""`gelgate record`: frames from a sensor, or from a folder of press images, into a recording."""

from pathlib import Path
from typing import Annotated, Any

import typer

__all__ = ["record"]

_SAY_EVERY_NS = 5_000_000_000

Out = Annotated[Path, typer.Argument(help="The folder to write; it must be empty or not exist.")]
DeviceName = Annotated[str | None, typer.Option("--device", help="A device plugin, such as gelsight_mini.")]
OptionTexts = Annotated[
    list[str] | None, typer.Option("--option", help="A device option, as name=value; repeatable.")
]
Seconds = Annotated[float | None, typer.Option(min=0.0, help="Stop after so many seconds.")]
Frames = Annotated[int | None, typer.Option(min=1, help="Stop after so many frames.")]
Images = Annotated[
    Path | None, typer.Option("--from-images", help="A folder of press images instead of a device.")
]
Pattern = Annotated[str, typer.Option(help="Which files of that folder, such as '*/gelsight.png'.")]
Reference = Annotated[Path | None, typer.Option(help="The image without contact, shown between the presses.")]
Fps = Annotated[float, typer.Option(min=0.1, max=999, help="Frames per second of the recording from images.")]
Free = Annotated[int, typer.Option("--repeat-free", min=0, help="Frames of every lift.")]
Lead = Annotated[
    int,
    typer.Option("--lead", min=0, help="More frames of the first lift, in which the free gel is learnt."),
]
Press = Annotated[int, typer.Option("--repeat-press", min=1, help="Frames of every press.")]
Number = Annotated[
    bool,
    typer.Option(
        help="Write a comment into each copy: same pixels, but not taken for the last frame again.",
    ),
]
Noise = Annotated[float | None, typer.Option(help="Add noise of this many grey levels (sd) to copies.")]
Seed = Annotated[int, typer.Option(help="Seed of that noise.")]
Product = Annotated[str, typer.Option(help="Product string of the recording from images.")]
Serial = Annotated[str, typer.Option(help="Serial of the recording from images.")]
Profile = Annotated[str, typer.Option(help="Sensor profile that the frames suit, kept as a hint.")]


def record(
    out: Out,
    device: DeviceName = None,
    option: OptionTexts = None,
    seconds: Seconds = None,
    frames: Frames = None,
    from_images: Images = None,
    pattern: Pattern = "**/*",
    reference: Reference = None,
    fps: Fps = 18.75,
    lead: Lead = 20,
    repeat_free: Free = 20,
    repeat_press: Press = 12,
    number_copies: Number = True,
    noise: Noise = None,
    seed: Seed = 0,
    product: Product = "GelSight Mini R0B 2BNN-4ZE7",
    serial: Serial = "2BNN4ZE7",
    profile: Profile = "",
) -> None:
    """Record frames from a device (Ctrl-C ends it), or make a press-and-lift recording from images.

    Copies of an image get a number each, for identical frames are what a hung camera sends, and are left out by the
    gateway and by fit alike. Nothing is invented unless asked for.
    """
    from edge.core.errors import ConfigError

    if (device is None) == (from_images is None):
        raise ConfigError("name either --device or --from-images; `gelgate devices` lists the devices")
    if device is not None:
        typer.echo(_from_device(out, device, option or [], seconds, frames, profile))
        return
    from edge.recording.from_images import CopyNoise, PressLift, images_in, record_images

    assert from_images is not None
    presses = [
        path for path in images_in(from_images, pattern) if reference is None or not path.samefile(reference)
    ]
    try:
        plan = PressLift(
            fps=fps,
            lead_frames=lead,
            free_frames=repeat_free,
            press_frames=repeat_press,
            number_copies=number_copies,
            noise=CopyNoise(noise, seed) if noise else None,
        )
    except ValueError as error:
        raise ConfigError(str(error)) from error
    count = record_images(out, presses, reference, plan, product=product, serial=serial, profile=profile)
    typer.echo(f"{out}: {count} frames, {len(presses)} presses at {fps} fps")


def _from_device(
    out: Path, name: str, given: list[str], seconds: float | None, frames: int | None, profile: str
) -> str:
    from edge import registry
    from edge.cli.plugin_options import plugin_options
    from edge.clock import SystemClock
    from edge.core.errors import GelgateError
    from edge.recording.format import RecordingHeader, RecordingWriter

    clock = SystemClock()
    plugin = registry.device(name)
    sensor = plugin.open(plugin_options("devices", name, plugin.Options, given), clock)
    try:
        who = sensor.identity
        header = RecordingHeader(who.product, who.serial, who.mode, who.nominal_fps, profile)
        with RecordingWriter(out, header) as writer:
            typer.echo(f"recording {who.product} to {out}; Ctrl-C ends it", err=True)
            end_ns = clock.monotonic_ns() + round(seconds * 1e9) if seconds is not None else None
            try:
                corrupt, ending = _copy_frames(sensor, writer, clock, end_ns, frames)
            except GelgateError:
                typer.echo(f"{out}: {len(writer)} frames were recorded and are kept", err=True)
                raise
            return f"{out}: {len(writer)} frames, {corrupt} corrupt ones left out{ending}"
    finally:
        sensor.close()


def _copy_frames(
    sensor: Any, writer: Any, clock: Any, end_ns: int | None, frames: int | None
) -> tuple[int, str]:
    """(number of corrupt frames, how it ended). A sensor that goes away ends the recording with an error."""
    from edge.core.errors import FrameCorrupt, RecordingEnded

    corrupt = 0
    said_ns = clock.monotonic_ns()
    try:
        while (frames is None or len(writer) < frames) and (end_ns is None or clock.monotonic_ns() < end_ns):
            try:
                frame = sensor.read(clock.monotonic_ns() + 5_000_000_000)
            except FrameCorrupt:
                corrupt += 1
                continue
            writer.add(frame.payload, frame.timestamp_ns)
            if frame.timestamp_ns - said_ns >= _SAY_EVERY_NS:
                said_ns = frame.timestamp_ns
                typer.echo(f"{len(writer)} frames", err=True)
    except RecordingEnded:
        return corrupt, "; the recording that was played is over"
    except KeyboardInterrupt:
        return corrupt, "; stopped by hand"
    return corrupt, ""
