"""`gelgate record`: frames from a sensor, a film, or a folder of press images, into a recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from edge import registry
from edge.cli.arguments import add_argument, add_option, flatten, plugin_options
from edge.clock import SystemClock
from edge.core.errors import ConfigError, FrameCorrupt, GelgateError, RecordingEnded
from edge.core.imaging.known_profiles import profile as named
from edge.core.imaging.sensor_profile import cut_in_words
from edge.core.printable import write_count
from edge.recording.format import Recording, RecordingHeader, RecordingWriter
from edge.recording.from_images import PressLift, images_in, record_images
from edge.recording.from_video import film_of, record_video
from edge.recording.presses_in import find_profile, presses_in

__all__ = ["RecordArguments", "record"]

_SAY_EVERY_NS = 5_000_000_000
# A film that says how many frames it has by its length and rate is right to some frames.
_ESTIMATED = 0.95


@dataclass(frozen=True)
class RecordArguments:
    """What the command line says."""

    out: Path = add_argument(..., "The folder to write; it must be empty or not exist.")
    device: str | None = add_option(None, "A device plugin, such as gelsight_mini.")
    option: list[str] | None = add_option(None, "A device option, as name=value; repeatable.")
    seconds: float | None = add_option(None, "Stop after this number of seconds.", min=0.0)
    frames: int | None = add_option(None, "Stop after this number of frames.", min=1)
    from_images: Path | None = add_option(None, "A folder of press images instead of a device.")
    from_video: Path | None = add_option(None, "A video instead of a device; its frames keep their times.")
    resize: bool = add_option(
        False, "Crop a video's frames to the profile's aspect, in the middle, and scale them.", "--resize"
    )
    pattern: str = add_option("**/*", "Pattern of the files in that folder, such as '*/gelsight.png'.")
    reference: Path | None = add_option(None, "The image without contact, shown between the presses.")
    fps: float = add_option(18.75, "Frames per second of the recording from images.", min=0.1, max=999)
    lead: int = add_option(
        20, "Additional frames of the first lift, to learn the no-contact reference.", min=0
    )
    repeat_free: int = add_option(20, "Frames of every lift.", min=0)
    repeat_press: int = add_option(12, "Frames of every press.", min=1)
    number_copies: bool = add_option(
        True, "Write a comment into each copy, so that it is not taken for a repeated frame."
    )
    noise: float | None = add_option(None, "Add noise to copies: standard deviation in grey levels.")
    seed: int = add_option(0, "Seed of that noise.")
    product: str = add_option("GelSight Mini R0B 2BNN-4ZE7", "Product string of the recording from images.")
    serial: str = add_option("2BNN4ZE7", "Serial of the recording from images.")
    profile: str = add_option(
        "", "Sensor profile of the frames, kept as a hint; without it presses are counted by their size."
    )


@flatten
def record(given: RecordArguments) -> None:
    """Record frames from a device, video or press images.

    The number of presses that the gateway finds in the recording is printed at the end.

    Ctrl-C ends a recording from a device. From images, a sequence of presses and lifts is made. A hung camera sends
    identical frames, which the gateway and fit leave out, so each copy of an image gets a number. No noise is added
    by default.
    """
    if sum(source is not None for source in (given.device, given.from_images, given.from_video)) != 1:
        raise ConfigError(
            "name one of --device, --from-video and --from-images; `gelgate devices` lists the devices"
        )
    if given.profile:
        named(given.profile)  # an unknown one is refused before the work
    if given.device is not None:
        done = _from_device(given, given.device)
    elif given.from_video is not None:
        done = _from_video(given, given.from_video)
    else:
        assert given.from_images is not None
        done = _from_images(given, given.from_images)
    typer.echo(done)
    is_free_shown = given.from_images is None or given.reference is not None
    _say_presses(given.out, given.profile, is_free_shown)


def _from_images(given: RecordArguments, folder: Path) -> str:
    """Record press images. Errors: ConfigError."""
    free = given.reference
    images = [path for path in images_in(folder, given.pattern) if free is None or not path.samefile(free)]
    try:
        plan = PressLift(
            given.fps,
            given.lead,
            given.repeat_free,
            given.repeat_press,
            given.number_copies,
            given.noise or 0,
            given.seed,
        )
    except ValueError as error:
        raise ConfigError(str(error)) from error
    names = {"product": given.product, "serial": given.serial, "profile": given.profile}
    count = record_images(given.out, images, free, plan, **names)
    return (
        f"{given.out}: {write_count(count, 'frame')}, {write_count(len(images), 'press')} at {plan.fps} fps"
    )


def _from_video(given: RecordArguments, path: Path) -> str:
    """Record a film. Errors: ConfigError where it has another size than the profile's camera."""
    profile, resize = given.profile, given.resize
    film = film_of(path)
    wanted = named(profile).native if profile else None
    is_other = wanted is not None and wanted != film.size
    if resize and wanted is None:
        raise ConfigError(
            "--resize needs --profile: the profile says which size is wanted, such as cropped_lr"
        )
    if is_other and wanted is not None and (not resize or wanted > film.size):
        raise ConfigError(
            f"{path} has frames of {film.size[0]}x{film.size[1]}, profile '{profile}' takes {wanted[0]}x{wanted[1]}; "
            + (
                "add --resize to cut and scale them, or leave --profile out to keep them as they are"
                if not resize
                else "a film is not scaled up: choose a smaller profile, such as cropped_lr"
            )
        )
    count = record_video(
        given.out,
        film,
        size=wanted if is_other else None,
        product=given.product,
        serial=given.serial,
        profile=profile,
    )
    scaled = f", {cut_in_words(film.size, wanted)}" if is_other and wanted else ""
    is_short = count < _ESTIMATED * film.frames
    missing = f"; it says it has {film.frames}: it is cut, or has damaged frames" if is_short else ""
    return f"{given.out}: {write_count(count, 'frame')} of {path.name}{scaled}{missing}"


def _say_presses(out: Path, name: str, is_free_shown: bool) -> None:
    """Print what the gateway would find, with this profile or one for frames of this size."""
    recording = Recording.open(out)
    mode, profile = recording.header.mode, find_profile(recording, name)
    if profile is None:
        typer.echo(f"presses in it are not counted: no sensor profile has frames of {mode[0]}x{mode[1]}")
        return
    typer.echo("counting its presses; Ctrl-C leaves that out", err=True)
    try:
        summary, doubts = presses_in(recording, profile)
    except KeyboardInterrupt:
        typer.echo("presses in it are not counted")
        return
    typer.echo(f"seen in it: {summary}")
    if not is_free_shown:
        doubts.append(
            "between the presses no free gel is shown, so they may not be found; give its picture with --reference"
        )
    for doubt in doubts:
        typer.echo(f"warning: {doubt}", err=True)


def _from_device(given: RecordArguments, name: str) -> str:
    clock = SystemClock()
    plugin = registry.device(name)
    sensor = plugin.open(plugin_options("devices", name, plugin.Options, given.option or []), clock)
    try:
        who = sensor.identity
        header = RecordingHeader(who.product, who.serial, who.mode, who.nominal_fps, given.profile)
        with RecordingWriter(given.out, header) as writer:
            typer.echo(f"recording {who.product} to {given.out}; Ctrl-C ends it", err=True)
            end_ns = None if given.seconds is None else clock.monotonic_ns() + round(given.seconds * 1e9)
            try:
                corrupt, ending = _copy_frames(sensor, writer, clock, end_ns, given.frames)
            except GelgateError:
                typer.echo(
                    f"{given.out}: what was recorded is kept: {write_count(len(writer), 'frame')}", err=True
                )
                raise
            return f"{given.out}: {write_count(len(writer), 'frame')}, {corrupt} corrupt left out{ending}"
    finally:
        sensor.close()


def _copy_frames(
    sensor: Any, writer: Any, clock: Any, end_ns: int | None, frames: int | None
) -> tuple[int, str]:
    """(number of corrupt frames, how it ended). A sensor that goes away ends the recording with an error."""
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
                typer.echo(write_count(len(writer), "frame"), err=True)
    except RecordingEnded:
        return corrupt, "; the played recording has ended"
    except KeyboardInterrupt:
        return corrupt, "; stopped with Ctrl-C"
    return corrupt, ""
