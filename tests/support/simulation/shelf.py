"""The folders of the bundles, and the person who exchanges one: by a new one, an old one, a wrong or a broken one."""

import hashlib
import json
import random
import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from edge.model.bundle import GoldenFrame
from simulation.bundles import PARTS
from simulation.process_faults import stop

if TYPE_CHECKING:
    from simulation.schedule import Simulation

BROKEN = ("changed under its manifest", "of another part", "cut", "half copied", "removed")
"""Such a bundle is refused (docs/operations.md, What happens when)."""


PROMISE = {"alpha_floor": 0.05, "nominal_scores": [0.01] * 19, "pieces": 19}
"""One of twenty sound parts fails, says each bundle."""
PRESSED = {"sound": ((0.01, 0.02), (0.03, 0.035), (0.04, 0.05)), "damaged": {"dent": (0.2, 9.0)}}
"""What each knows of parts that were pressed twice: of whatever would fail another press pays."""


class Shelf:
    """The bundles of a run. paths: those that are configured, one of each part, and `shadow`. has_free_view: each
    knows the gel of its fit. has_promise: the shadow promises a rate of false alarms, too."""

    def __init__(
        self, folder: Path, bundles: Sequence[Path], *, has_free_view: bool, has_promise: bool
    ) -> None:
        self._kept = folder / "kept"
        self._kept.mkdir(parents=True)
        self._originals = [shutil.copytree(path, folder / "made" / path.name) for path in bundles]
        for path in self._originals:
            _set(path, "threshold", **PROMISE)
            _set(path, "facts", press_again=PRESSED)
            if not has_free_view:
                _set(path, free_view=None)
        self.paths = [folder / part for part in PARTS]
        for original, path in zip(self._originals, self.paths, strict=True):
            shutil.copytree(original, path)
        self._shadow = bundles[0].with_name("shadow")
        shutil.copytree(self._shadow, folder / "shadow")
        _set(folder / "shadow", revision=1 << 30)  # an older one would not be scored
        if has_promise:
            _set(folder / "shadow", "threshold", **PROMISE)
        self.ids = [_identify(path) for path in self.paths]
        """Of the bundle that each part should have after a reload."""
        self.parts = dict(zip(self.ids, PARTS, strict=True))
        """Of each bundle that was ever there, and is whole."""
        self.wrong: dict[int, str] = {}
        """What is the matter with that of a part."""
        self.asked = 0
        """Requests to open what is there."""
        self.is_asked = False
        """Since the last exchange."""
        self.breaks = 0
        """Bundles that were exchanged by a wrong one; each kind has its turn."""
        self._revision = 0
        self.heir = _identify(folder / "shadow") if has_promise else ""
        """The shadow that may take over, and the bundle of the first part where it has."""
        if has_promise:
            self.parts[self.heir] = PARTS[0]
        self.has_taken_over = self.is_takeover_open = False
        """They were exchanged; and nobody has acknowledged it."""
        self.is_shadow_broken = False

    @property
    def replayed(self) -> list[Path]:
        """All bundles that may have judged."""
        return [*self._originals, self._kept, self.paths[0].with_name("shadow")]

    def put(self, part: int, kind: str) -> None:
        """Exchange one. kind: `newer`, or one of BROKEN."""
        path = self.paths[part]
        if kind != "changed under its manifest":
            shutil.rmtree(path, ignore_errors=True)
        self.wrong.pop(part, None)
        self.is_asked = False
        if kind == "newer":
            self._revision += 1
            self._write_next(part)
            return
        if kind not in ("changed under its manifest", "removed"):
            shutil.copytree(self._originals[1 - part if kind == "of another part" else part], path)
        self.wrong[part], self.breaks = kind, self.breaks + 1
        head = path / "head.onnx"
        if kind == "cut":
            head.write_bytes(head.read_bytes()[:-100])
        elif kind == "changed under its manifest":
            head.write_bytes(head.read_bytes().replace(b"brighter", b"darkened"))
        elif kind == "half copied":
            shutil.rmtree(path / "bank")

    def break_shadow(self, *, is_broken: bool) -> None:
        """Cut a file of the shadow, or put it back as it was."""
        self.is_shadow_broken, self.is_asked = is_broken, False
        head = self.paths[0].with_name("shadow") / "head.onnx"
        whole = (self._shadow / "head.onnx").read_bytes()
        head.write_bytes(whole[:-100] if is_broken else whole)

    def let_take_over(self) -> None:
        """The shadow takes over, or gives the place back."""
        self.ids[0], self.heir = self.heir, self.ids[0]
        self.has_taken_over = self.is_takeover_open = True
        self.note_asked()

    def move(self, part: int) -> None:
        """Put a newer one into another folder."""
        shutil.rmtree(self.paths[part])
        self._revision += 1
        self.paths[part] = self.paths[part].with_name(f"{PARTS[part]} {self._revision}")
        self._write_next(part)

    def note_asked(self) -> None:
        """All that is there is to be opened."""
        self.asked, self.is_asked = self.asked + 1, True

    def _write_next(self, part: int) -> None:
        path = self.paths[part]
        shutil.copytree(self._originals[part], path)
        _set(path, revision=self._revision)
        self.ids[part] = _identify(path)
        self.parts[self.ids[part]] = PARTS[part]
        shutil.copytree(path, self._kept / self.ids[part])


def _set(path: Path, entry: str = "", **values: object) -> None:
    """Change the manifest of a bundle, or one entry of it."""
    manifest = json.loads((path / "manifest.json").read_text())
    (manifest[entry] if entry else manifest).update(values)
    (path / "manifest.json").write_text(json.dumps(manifest))


def _identify(path: Path) -> str:
    return hashlib.sha256((path / "manifest.json").read_bytes()).hexdigest()


def exchange_bundle(run: "Simulation", rng: random.Random) -> float:
    """A person exchanges the bundle of a part, and mostly has it opened, or starts the service again; what is wrong
    is found later, and mended."""
    shelf, station = run.world.shelf, run.station
    if shelf.wrong:
        return -1.0
    kind, how = (
        rng.choice(("newer", BROKEN[(run.run.seed + shelf.breaks) % len(BROKEN)])),
        rng.choice((*["reload"] * 4, "restart", "later")),
    )
    lasts_s = rng.choice((2.0, 5.0, 15.0) if kind == "newer" else (9.0,))
    part = PARTS.index(run.world.parts.wanted) if rng.random() < 0.7 else rng.randrange(2)
    shelf.put(part, kind)
    run.reach_here(f"a bundle was {kind}")

    def mend() -> None:
        if kind != "newer":
            shelf.put(part, "newer")
        station.ask("reload")
        shelf.note_asked()

    if kind == "newer" and how != "later":
        run.note(f"bundle of {PARTS[part]} {kind}, {how}")
    else:
        run.for_a_while(f"bundle of {PARTS[part]} {kind}, {how}", lasts_s, mend)
    if how == "reload":
        station.ask("reload")
        shelf.note_asked()
    elif how == "restart":
        stop(run, rng)
    return 0.0


def break_shadow(run: "Simulation", rng: random.Random) -> float:
    """A person copies a shadow that is cut, and has it opened; later the whole one."""
    if not run.chosen.has_shadow:
        return 60.0

    def put(*, is_broken: bool) -> None:
        run.world.shelf.break_shadow(is_broken=is_broken)
        run.station.ask("reload")
        run.world.shelf.note_asked()

    put(is_broken=True)
    return run.for_a_while("shadow cut", rng.choice((8.0, 14.0)), partial(put, is_broken=False))


def score_otherwise(run: "Simulation", rng: random.Random) -> float:
    """The computer, or its memory, is not what it was: golden frames of the bundle in use score otherwise, until that
    is mended. A self-test asks for their scores at once."""
    station = run.station
    if station.off_bundle is not None:
        return -1.0
    bundle = station.off_bundle = station.loop.parts.selection.inspector.bundle
    sound = bundle.golden

    def score(golden: tuple[GoldenFrame, ...]) -> None:
        object.__setattr__(bundle, "golden", golden)
        station.loop.parts.selection.golden.request()

    def mend() -> None:
        station.off_bundle = None
        score(sound)

    score(tuple(replace(one, rgb=one.rgb * 0) for one in sound))
    return run.for_a_while("golden frames otherwise", rng.choice((12.0, 20.0)), mend)
