"""What a seed chooses, and the schedule of a run's faults: drawn, or given so that it plays again."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any


@dataclass(frozen=True)
class Fault:
    """One fault of a schedule. seed: of what it draws, as how long it lasts."""

    at_s: float
    name: str
    seed: int


PICTURES_MB, SMALL_MB, TINY_MB = 0.12, 0.03, 0.01
"""Less than a person may set: some ten pictures are more, some twenty results, or some seven."""


def is_small(outbox_mb: float) -> bool:
    """Say whether a run fills such an outbox."""
    return outbox_mb < 1


OTHERWISE, MARK_GEL = "score otherwise", "mark gel"
SNAPSHOT, REFERENCE, OVERVIEW, AGAIN = "snapshot", "reference_press", "overview", "press_again"
"""Features, two by the requests that they serve."""

FULL = (("fill disk", "kill", "hang up"), ("fill disk", "lose power"), ("fill disk", "replace gel"))
MEETINGS = (
    *FULL,
    ("silence",),
    ("blind",),
    ("damage",),
    ("freeze", "hold back"),
    ("kill",),
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

LATER = (
    *("lock database", "exchange bundle", "second sensor", "kill start", "stop hanging"),
    "edit configuration",
)
"""Faults that take turns in runs of all kinds, one in each."""

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


MOODS = (
    *("away", "restarts without memory", "silent", "forgets answers", "refuses", "restarts without memory"),
    *("kicks", "is narrow", "doubles", "delays", "answers late", "answers another", "ignores", "denies"),
    *("lets one in", "restarts with an old memory"),
)
CONNECTIONS = (
    *("away", "restarts without memory", "restarts with an old memory", "silent", "kicks", "denies"),
    "lets one in",
)
ANSWERS = tuple(mood for mood in MOODS if mood not in CONNECTIONS)
"""What brokers may do."""


@dataclass(frozen=True)
class Family:
    """Faults that belong together, in a minute so many of each, and the options of a run that has no others."""

    rates: dict[str, float]
    options: dict[str, Any] = field(default_factory=dict)


FAMILIES = (
    Family({"select part": 30, "stop": 4}, {"trigger": "command", "is_slow": True}),
    Family({"hang": 20, "freeze": 6, "relay": 4}, {"has_robot": True, "until_next": True, "presses": 40}),
    Family({"lock database": 60}, {"presses": 40}),
    Family({"exchange bundle": 40, "edit configuration": 20, "select part": 10}, {"presses": 40}),
    Family(
        {REFERENCE: 12, "replace gel": 6, "relearn": 3}, {"features": (REFERENCE,), "has_free_view": False}
    ),
    Family({OVERVIEW: 12}, {"features": (OVERVIEW,), "presses": 40}),
    Family(
        {"hang up": 15, "stop": 20},
        {"outbox_mb": PICTURES_MB, "presses": 40, "brokers": 1, "moods": ("away",)},
    ),
    Family({"silence": 10, "unplug": 5, "stop": 6, "request": 40}, {"has_page": True}),
    Family(
        {"say": 20, SNAPSHOT: 20, "adopt": 12, "lose power": 6, "break tool": 12},
        {"has_shadow": True, "features": (SNAPSHOT,)},
    ),
    Family(
        {MARK_GEL: 4, "break tool": 6, "stop": 1},
        {"features": (AGAIN,), "presses": 24, "fps": 9.0, "has_shadow": False},
    ),
    Family(
        {"say": 60, "adopt": 4, "break tool": 12, "acknowledge": 4, "stop": 2},
        {"has_shadow": True, "has_heir": True, "is_lenient": True, "has_archive": True, "presses": 36},
    ),
    Family({"plc": 5, "second plc": 2, "select part": 8, "silence": 1}, {"plc": "modbus", "is_slow": True}),
    # They stop nothing, so that what lasts for presses or seconds may be said.
    Family(
        {"break shadow": 6, "break tool": 8, OTHERWISE: 4, "hang up": 6},
        {"has_shadow": True, "level": "5", "moods": ("refuses",), "presses": 30},
    ),
    Family({"hang up": 40, "stop": 4, "step clock": 6, "request": 40}, {"moods": CONNECTIONS, "presses": 30}),
    Family(
        {"hang up": 40, "kill": 6, "stop": 4, "bad disk": 3, "slow disk": 3},
        {"moods": ANSWERS, "level": "5", "presses": 40},
    ),
    # A kill before would be kinder: what was written is on the disk when the next process begins.
    Family({"lose power": 10, "replace gel": 6}, {"has_file": True, "has_archive": True}),
    Family({"silence": 10, "unplug": 8, "hold back": 6, "blind": 6, "kill": 4}),
    Family({"plc": 5, "begin piece": 8, "stop": 2}, {"plc": "opcua", "piece": "free", "is_slow": True}),
    Family({"begin piece": 12, "stop": 2}, {"piece": "fixed", "presses": 40}),
    Family({"acknowledge": 2}, {"meetings": (FULL[0], FULL[1], FULL[0], FULL[2], FULL[0])}),
    Family({"freeze": 20, "hold back": 10, "shake": 2, "damage": 2}, {"stamps_late": False}),
    Family({"second sensor": 20, "kill start": 6, "stop hanging": 6, "lose database": 4}),
)
"""Three of four seeds have one of them alone, and take turns: what meets everything else in the fourth is rare."""


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
    has_pedal: bool = False
    """And asks with it; otherwise a pedal acknowledges alarms."""
    outbox_mb: float = 512
    has_file: bool = False
    """A `jsonl` sink, too."""
    has_shadow: bool = False
    has_heir: bool = False
    """The shadow promises a rate of false alarms, so that it may take over by what people say."""
    has_free_view: bool = True
    """Bundles know the gel of their fit, so that a part which lies on a new one is seen at once."""
    is_lenient: bool = False
    """People call dented parts good."""
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
    presses: int = 22
    """Of the hand, where nobody asks for another number."""
    moods: tuple[str, ...] = ()
    """Of brokers; empty for mostly `away`, and else any."""
    features: tuple[str, ...] = ()
    """Those that are configured beside what each station has."""
    is_slow: bool = False
    """The hand presses slowly, so that much may come between a press and its verdict."""
    until_next: bool = False
    """What stops sensor or process mostly ends as the next part comes."""
    stamps_late: bool = False
    """The driver stamps a frame when it is read, as both that are built in do, and not when it was made."""

    @property
    def faults(self) -> set[str]:
        """The names of all that are drawn."""
        return {*self.rates, *(name for meeting in self.meetings for name in meeting)}

    @classmethod
    def of(cls, seed: int, names: Sequence[str]) -> "Chosen":
        """Draw. Of four seeds that follow each other three have a family of faults each, and one has all kinds."""
        rng, number = random.Random(f"{seed} chosen"), seed // 4
        chosen = cls(
            rng.choice((1, 2)),
            rng.random() < 0.8,
            {},
            rng.choice((0.0, 0.01, 0.03)),
            rng.choice((18.75, 18.75, 9.0, 7.0)),
            rng.choice(("5", "5", "5", "3.1.1", "silent at 5")),
            has_file=rng.random() < 0.25,
            has_shadow=rng.random() < 0.25,
            has_robot=rng.random() < 0.3,
            is_lenient=number // 2 % 2 == 1,
            has_pedal=number // 2 % 2 == 0,
            has_serial=number // 6 % 2 == 1,
            forgets=number % 2 == 0,
            is_slow=rng.random() < 0.2,
            until_next=rng.random() < 0.5,
            stamps_late=rng.random() < 0.5,
        )
        if seed % 4:
            family = FAMILIES[(seed - number - 1) % len(FAMILIES)]
            chosen = replace(chosen, rates=family.rates, **family.options)
            return replace(chosen, has_pedal=chosen.has_pedal and chosen.trigger == "command")
        return chosen._mix(number, names, rng)

    def _mix(self, number: int, names: Sequence[str], rng: random.Random) -> "Chosen":
        """Choose faults of all kinds. Most are left out of a run, so that others meet; runs that follow each other have
        every kind and every meeting. A PLC is always disturbed, and met by a second one."""
        drawn = [
            name for name in names if name not in ("begin piece", "hang", OTHERWISE, MARK_GEL, *LATER)
        ]  # which come below
        rates = {name: rng.choice((1.0, 4.0)) for name in drawn if rng.random() < 0.1}
        rates |= {drawn[turn % len(drawn)]: 4.0 for turn in (number, 5 * number + 7)}
        rates[LATER[number % len(LATER)]] = 4.0
        trigger, plc, piece = WORK[number % len(WORK)]
        # A person asks for a master piece, and the code selects.
        is_plain = not (plc or piece or trigger == "command")
        possible = (SNAPSHOT, REFERENCE, OVERVIEW) if is_plain else (SNAPSHOT,)
        chosen = replace(
            self,
            trigger=trigger,
            has_pedal=self.has_pedal and trigger == "command",
            plc=plc,
            piece=piece,
            outbox_mb=rng.choice((*[512] * 8, SMALL_MB, TINY_MB)),
            meetings=tuple(MEETINGS[(number + step) % len(MEETINGS)] for step in MEETING_STEPS),
            features=tuple(name for name in possible if rng.random() < 0.5),
            has_page=rng.random() < 0.25,
        )
        # People cost little: somebody always asks, and selects where neither a plan nor a PLC does.
        rates["request"] = 4.0
        if not piece:
            rates["select part"] = 4.0
        elif plc:
            rates["begin piece"] = 4.0
        if is_small(chosen.outbox_mb):  # it is filled, and then the station begins anew
            rates |= dict.fromkeys(("hang up", "stop"), 4.0)
            chosen = replace(chosen, presses=30)
        if rng.random() < 0.2:
            rates["hang"] = 4.0
        rates |= {"say": 4.0, **dict.fromkeys(chosen.features, 4.0)}
        rates.setdefault("hang up", 1.0)
        if plc:
            rates = {"second plc": 1.0, **rates, "plc": 6.0}
        chosen = replace(chosen, rates=rates)
        # What a file has not synced is lost with the power alone.
        return replace(chosen, has_file=chosen.has_file or "lose power" in chosen.faults)
