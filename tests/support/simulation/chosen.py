"""What a seed chooses, and the schedule of a run's faults: drawn, or given so that it plays again."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field, replace


@dataclass(frozen=True)
class Fault:
    """One fault of a schedule. seed: of what it draws, as how long it lasts."""

    at_s: float
    name: str
    seed: int


SMALL_MB, TINY_MB = 0.03, 0.01
"""Less than a person may set: some twenty results are more, or some seven."""


def is_small(outbox_mb: float) -> bool:
    """Say whether a run fills such an outbox."""
    return outbox_mb < 1


SNAPSHOT, REFERENCE, OVERVIEW = "snapshot", "reference_press", "overview"
"""Features, two by the requests that they serve."""

MEETINGS = (
    ("silence",),
    ("blind",),
    ("damage",),
    ("freeze", "hold back"),
    ("kill",),
    ("fill disk", "kill", "hang up"),
    ("fill disk", "lose power"),
    ("fill disk", "replace gel"),
    ("select part", "replace gel"),
    ("hang up", "kill"),
    ("hang up", "stop"),
    ("hang up", "lose database"),
    ("hang up", "step clock"),
    ("select part", "stop"),
    ("request", "relay"),
    ("plc", "second plc"),
    ("plc", "stop"),
    ("plc", "unplug"),
)
"""Faults that do most harm together."""

MEETING_STEPS = (0, 5, 9, 12)
"""Which of them a run has, counted from its seed; they take turns."""

TURN_S, MET = 12, 12.0
"""A turn lasts so long at most; and of each fault of a meeting there are so many in a minute of it."""

LATER = ("lock database", "exchange bundle", "second sensor", "kill start", "stop hanging")
"""Faults that take turns, one in each third run, and do not change what else a seed draws."""

WORK = (
    ("command", "", ""),
    ("automatic", "modbus", "fixed"),
    ("automatic", "", "free"),
    ("automatic", "opcua", ""),
    ("automatic", "", ""),
    ("automatic", "opcua", "fixed"),
    ("automatic", "", "fixed"),
    ("automatic", "modbus", ""),
    ("command", "", ""),
    ("automatic", "opcua", "free"),
    ("automatic", "modbus", "free"),
    *[("automatic", "", "")] * 3,
)
"""Trigger, PLC and order of a piece: each seed has the next. With neither a master piece may be pressed, or the code on
a part select."""


@dataclass(frozen=True)
class Chosen:
    """The options of a run. rates: faults per simulated minute, of those that are drawn."""

    brokers: int = 1
    has_archive: bool = True
    rates: dict[str, float] = field(default_factory=dict)
    sloth_s: float = 0.0
    """The longest wait of a ready actor for its turn."""
    fps: float = 18.75
    level: str = "5"
    """Of MQTT, that the brokers speak: `5`, `3.1.1`, or `silent at 5`."""
    trigger: str = "automatic"
    """Or `command`: a person asks for most verdicts, and forgets some."""
    outbox_mb: float = 512
    has_file: bool = False
    """A `jsonl` sink, too."""
    has_shadow: bool = False
    has_robot: bool = False
    """It holds each part until the station says that it may be lifted, or its patience ends."""
    plc: str = ""
    """`modbus` or `opcua`: it triggers, and reads what answers; only with `trigger = "automatic"`."""
    piece: str = ""
    """The order of a plan of places, `fixed` or `free`; empty for none. A PLC begins the pieces, else a person."""
    meetings: tuple[tuple[str, ...], ...] = ()
    """Faults that come often while it is their turn."""
    has_serial: bool = False
    """The configuration names the sensor."""
    has_page: bool = False
    """A browser asks it all the time."""
    forgets: bool = False
    """Each broker restarts without its memory when all faults have ended."""
    features: tuple[str, ...] = ()
    """Those that are configured beside what each station has."""
    stamps_late: bool = False
    """The driver stamps a frame when it is read, as both that are built in do, and not when it was made."""

    @property
    def faults(self) -> set[str]:
        """The names of all that are drawn."""
        return {*self.rates, *(name for meeting in self.meetings for name in meeting)}

    @classmethod
    def of(cls, seed: int, names: Sequence[str]) -> "Chosen":
        """Draw. Most kinds of fault are left out of a run, so that others meet alone; seeds that follow each other have
        every kind and every meeting. A PLC is always disturbed, and met by a second one."""
        rng = random.Random(f"{seed} chosen")
        drawn = [name for name in names if name not in ("begin piece", "hang", *LATER)]  # which come below
        rates = {name: rng.choice((1.0, 4.0)) for name in drawn if rng.random() < 0.1}
        rates |= {drawn[turn % len(drawn)]: 4.0 for turn in (seed, 5 * seed + 7)}
        trigger, plc, piece = WORK[seed % len(WORK)]
        chosen = cls(
            rng.choice((1, 2)),
            rng.random() < 0.8,
            rates,
            rng.choice((0.0, 0.01, 0.03)),
            rng.choice((18.75, 18.75, 9.0, 7.0)),
            rng.choice(("5", "5", "5", "3.1.1", "silent at 5")),
            trigger,
            rng.choice((*[512] * 8, SMALL_MB, TINY_MB)),
            rng.random() < 0.25,
            rng.random() < 0.25,
            rng.random() < 0.3,
            plc,
            piece,
            tuple(MEETINGS[(seed + step) % len(MEETINGS)] for step in MEETING_STEPS),
            forgets=seed % 2 == 0,
        )
        # People cost little: somebody always asks, and selects where neither a plan nor a PLC does.
        rates["request"] = 4.0
        if not chosen.piece:
            rates["select part"] = 4.0
        elif chosen.plc:
            rates["begin piece"] = 4.0
        if is_small(chosen.outbox_mb):  # it is filled, and then the station begins anew
            rates |= dict.fromkeys(("hang up", "stop"), 4.0)
        if rng.random() < 0.2:
            rates["hang"] = 4.0
        features = tuple(name for name in (SNAPSHOT, REFERENCE, OVERVIEW) if rng.random() < 0.5)
        if plc or piece or trigger == "command":  # a person asks for a master piece, and the code selects
            features = tuple(name for name in features if name == SNAPSHOT)
        chosen = replace(chosen, stamps_late=rng.random() < 0.5, features=features)
        rates |= {"say": 4.0, **dict.fromkeys(features, 4.0)}
        if seed % 3 == 0:
            rates[LATER[seed // 3 % len(LATER)]] = 4.0
        rates.setdefault("hang up", 1.0)
        own = random.Random(f"{seed} chosen later")
        chosen = replace(chosen, has_page=own.random() < 0.25, has_serial=own.random() < 0.5)
        if "lose power" in chosen.faults:  # what a file has not synced is lost then alone
            chosen = replace(chosen, has_file=True)
        disturbed = {"second plc": 1.0, **rates, "plc": 6.0}
        return replace(chosen, rates=disturbed) if chosen.plc and "plc" in names else chosen
