"""`gelgate record`: frames from a sensor, a film, or a folder of press images, into a recording."""

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
Seconds = Annotated[float | None, typer.Option(min=0.0, help="Stop after this number of seconds.")]
Frames = Annotated[int | None, typer.Option(min=1, help="Stop after this number of frames.")]
Images = Annotated[
    Path | None, typer.Option("--from-images", help="A folder of press images instead of a device.")
]
Video = Annotated[
    Path | None,
    typer.Option("--from-video", help="A video instead of a device; its frames keep their times."),
]
Resize = Annotated[
    bool,
    typer.Option(
        "--resize",
        help="Crop a video's frames to the profile's aspect, in the middle, and scale them.",
    ),
]
Pattern = Annotated[str, typer.Option(help="Pattern of the files in that folder, such as '*/gelsight.png'.")]
Reference = Annotated[Path | None, typer.Option(help="The image without contact, shown between the presses.")]
Fps = Annotated[float, typer.Option(min=0.1, max=999, help="Frames per second of the recording from images.")]
Free = Annotated[int, typer.Option("--repeat-free", min=0, help="Frames of every lift.")]
Lead = Annotated[
    int,
    typer.Option(
        "--lead", min=0, help="Additional frames of the first lift, to learn the no-contact reference."
    ),
]
Press = Annotated[int, typer.Option("--repeat-press", min=1, help="Frames of every press.")]
Number = Annotated[
    bool,
    typer.Option(
        help="Write a comment into each copy, so that it is not taken for a repeated frame.",
    ),
]
Noise = Annotated[float | None, typer.Option(help="Add noise to copies: standard deviation in grey levels.")]
Seed = Annotated[int, typer.Option(help="Seed of that noise.")]
Product = Annotated[str, typer.Option(help="Product string of the recording from images.")]
Serial = Annotated[str, typer.Option(help="Serial of the recording from images.")]
Profile = Annotated[
    str,
    typer.Option(
        help="Sensor profile of the frames, kept as a hint; without it presses are counted by their size."
    ),
]


def record(
    out: Out,
    device: DeviceName = None,
    option: OptionTexts = None,
    seconds: Seconds = None,
    frames: Frames = None,
    from_images: Images = None,
    from_video: Video = None,
    resize: Resize = False,
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
    """Record frames from a device, video or press images.

    The number of presses that the gateway finds in the recording is printed at the end.

    Ctrl-C ends a recording from a device. From images, a sequence of presses and lifts is made. A hung camera sends
    identical frames, which the gateway and fit leave out, so each copy of an image gets a number. No noise is added
    by default.
    """
    from edge.core.errors import ConfigError

    if sum(source is not None for source in (device, from_images, from_video)) != 1:
        raise ConfigError(
            "name one of --device, --from-video and --from-images; `gelgate devices` lists the devices"
        )
    if device is not None:
        typer.echo(_from_device(out, device, option or [], seconds, frames, profile))
    elif from_video is not None:
        typer.echo(_from_video(out, from_video, profile, resize, product, serial))
    elif from_images is not None:
        images = _images(from_images, pattern, reference)
        plan = _plan(fps, lead, repeat_free, repeat_press, number_copies, noise, seed)
        typer.echo(_from_images(out, images, reference, plan, profile, product, serial))
    _say_presses(out, profile)


def _from_images(
    out: Path, images: list[Path], reference: Path | None, plan: Any, profile: str, product: str, serial: str
) -> str:
    from edge.recording.from_images import record_images

    count = record_images(out, images, reference, plan, product=product, serial=serial, profile=profile)
    return f"{out}: {count} frames, {len(images)} presses at {plan.fps} fps"


def _images(folder: Path, pattern: str, reference: Path | None) -> list[Path]:
    from edge.recording.from_images import images_in

    return [path for path in images_in(folder, pattern) if reference is None or not path.samefile(reference)]


def _plan(
    fps: float, lead: int, free: int, press: int, number_copies: bool, noise: float | None, seed: int
) -> Any:
    """Errors: ConfigError."""
    from edge.core.errors import ConfigError
    from edge.recording.from_images import CopyNoise, PressLift

    try:
        return PressLift(fps, lead, free, press, number_copies, CopyNoise(noise, seed) if noise else None)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _from_video(out: Path, path: Path, profile: str, resize: bool, product: str, serial: str) -> str:
    """Errors: ConfigError where the film has another size than the profile's camera."""
    from edge.core.errors import ConfigError
    from edge.core.imaging.aspect import cut_in_words
    from edge.core.imaging.known_profiles import profile as named
    from edge.recording.from_video import film_of, record_video

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
        out, film, size=wanted if is_other else None, product=product, serial=serial, profile=profile
    )
    scaled = f", {cut_in_words(film.size, wanted)}" if is_other and wanted else ""
    return f"{out}: {count} frames of {path.name}{scaled}"


def _say_presses(out: Path, name: str) -> None:
    """What the gateway would find, with this profile or one for frames of this size."""
    from edge.core.imaging.known_profiles import PROFILES
    from edge.recording.format import Recording
    from edge.recording.presses_in import presses_in

    recording = Recording.open(out)
    mode = recording.header.mode
    profile = PROFILES.get(name) or next((one for one in PROFILES.values() if one.native == mode), None)
    if profile is None:
        typer.echo(f"presses in it are not counted: no sensor profile has frames of {mode[0]}x{mode[1]}")
        return
    typer.echo("counting its presses; Ctrl-C leaves that out", err=True)
    try:
        found = presses_in(recording, profile)
    except KeyboardInterrupt:
        typer.echo("presses in it are not counted")
        return
    typer.echo(f"seen in it: {found}")
    for doubt in found.doubts:
        typer.echo(f"warning: {doubt}", err=True)


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
        return corrupt, "; the played recording has ended"
    except KeyboardInterrupt:
        return corrupt, "; stopped with Ctrl-C"
    return corrupt, ""
