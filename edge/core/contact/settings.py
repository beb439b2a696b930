"""The numbers that decide what contact is, each with its source."""

from dataclasses import dataclass

__all__ = ["ContactSettings"]


@dataclass(frozen=True)
class ContactSettings:
    """When a frame counts as touched, at rest and released. Areas are fractions of the view, times seconds."""

    # On 500-1,000 and off 100-200 of 76,800 pixels separated contact from residue on the maker's press video.
    on_area: float = 0.010
    off_area: float = 0.002
    # Relief of this many levels (root mean square over a millimetre, all colours) is an imprint: sensor noise of the
    # sources measured stays below 2.
    light_levels: float = 3.5
    # The imprint left after a release is 5 to 25 % of the signal for seconds; an area this small against the press's
    # largest is a release, so that a hair or grease left behind cannot hold a press open.
    release_share: float = 0.05
    # Public tools confirm a contact over 2 to 5 frames at 25 to 30 frames a second.
    onset_s: float = 0.06
    release_s: float = 0.08
    # A press rests when its frame and the one `settle_s` before differ in fewer than `still_share` of the touched
    # pixels, and the imprint has not grown by `growth_share` meanwhile. Chosen on simulated presses: docs/contact.md.
    settle_s: float = 0.2
    still_share: float = 0.20
    growth_share: float = 0.03
    settle_timeout_s: float = 3.0
    min_frames: int = 2
    # Cameras start black or at the wrong level: the SDKs discard 10 frames.
    warm_up_s: float = 0.5
    resume_s: float = 0.3
    baseline_frames: int = 10
    # 5 to 19 % of the signal is still there 2 to 3 s after a release, so no reference is learnt before.
    recovery_s: float = 3.0
    refresh_s: float = 10.0
    refresh_weight: float = 0.3
    # After this time the first press against an unconfirmed reference is taken for the free gel.
    stuck_s: float = 30.0
    # Decoding is most of the cost of an idle gateway. No press of 2,040 was missed at this interval, nor in films of 5
    # frames a second: docs/contact.md.
    idle_interval_s: float = 0.15
    is_external: bool = False
    """Presses are scored on a trigger (command, pedal) instead of by themselves."""

    def __post_init__(self) -> None:
        if not 0 < self.off_area < self.on_area < 1:
            raise ValueError(
                f"0 < off_area < on_area < 1 is needed, found {self.off_area} and {self.on_area}"
            )
        shares = (self.release_share, self.still_share, self.growth_share, self.refresh_weight)
        if not all(0 <= share < 1 for share in shares):
            raise ValueError(f"shares lie in [0, 1), found {shares}")
        times = (self.onset_s, self.release_s, self.settle_s, self.warm_up_s, self.resume_s, self.recovery_s)
        if min(*times, self.idle_interval_s) < 0 or not 0 <= self.settle_s < self.settle_timeout_s:
            raise ValueError(
                f"times are not negative and the settle timeout exceeds the settle time, found {self}"
            )
        if min(self.min_frames, self.baseline_frames) < 1 or min(self.refresh_s, self.stuck_s) <= 0:
            raise ValueError(
                f"frame counts are at least 1 and refresh and stuck times positive, found {self}"
            )
        if self.light_levels <= 0:
            raise ValueError(f"light_levels is positive, found {self.light_levels}")
