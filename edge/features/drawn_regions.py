"""Regions that a person draws at the page: a new revision of the bundle in use, made by `gelgate bundle regions`.

That runs in a child process, as the first run of every bundle does: what extends a graph is not loaded into the
gateway. The revision before stays beside the new one, under a name that begins with a dot. What needs nominal presses,
as a stricter region does, is not done here: the answer has the command that does it.
"""

import subprocess
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Final, NamedTuple, Self

import numpy as np
from pydantic import Field, StringConstraints, model_validator

from edge.core.drawn_regions import DrawnRegion, Points, RegionKind
from edge.core.errors import BundleCorrupt
from edge.core.press import Press
from edge.core.registration.pose import Pose
from edge.messaging.command_payloads import CommandArguments, PlainText
from edge.messaging.payload_base import PressId
from edge.model.bundle import Bundle
from edge.model.bundle_writer import replace_bundle
from edge.model.inspector import Inspector
from edge.model.manifest import REGION_WEIGHTS
from edge.model.trial import try_bundle
from edge.press_stage import Command, Data, PressStage, StageParts
from edge.store import gel_proofs

__all__ = ["DrawnRegionsStage"]

# Presses on whose pictures something may be drawn: more than a page shows.
MOST_REMEMBERED: Final = 64
SECONDS: Final = 120.0

RegionName = Annotated[str, StringConstraints(pattern=r"^[^\s,]{1,64}$")]
"""Without a space: it is one word of a command."""


class SetRegionsArguments(CommandArguments):
    """Of `cmd/set_regions`. add: the name of a new region of this kind, its corners in mm from the top left corner of
    the picture of `press_id`. remove: the name of one that goes. One of the two."""

    add: RegionName | None = None
    kind: RegionKind = "ignore"
    points_mm: list[list[float]] = Field(default_factory=list, max_length=256)
    press_id: PressId | None = None
    remove: PlainText | None = Field(default=None, min_length=1, max_length=64)

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.add is None) == (self.remove is None):
            raise ValueError("expected either add or remove, the name of a region")
        if self.add is not None and self.press_id is None:
            raise ValueError("a region is drawn on the picture of a press; name its press_id")
        return self


class _Seen(NamedTuple):
    """How a press lay. fit: of the bundles whose bank has this pose."""

    fit: tuple[object, ...]
    pose: Pose | None


class DrawnRegionsStage(PressStage):
    """Remembers how presses lay, and makes new revisions."""

    def __init__(self, parts: StageParts) -> None:
        self._selection, self._post = parts.selection, parts.post
        self._store, self._clock = parts.store, parts.clock
        # Only signed bundles are used where a signature is required, and a station cannot sign.
        self._may_sign = parts.config.inspection.signed != "required"
        self._seen: OrderedDict[str, _Seen] = OrderedDict()
        self._drawing = threading.Lock()

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        return cls(parts)

    def keep(self, press: Press, inspector: Inspector) -> Press:
        """Remember how it lay."""
        if press.score_map is not None:
            pose = None if press.registered is None else press.registered.pose
            self._seen[press.press_id] = _Seen(_fit_of(inspector.bundle), pose)
            while len(self._seen) > MOST_REMEMBERED:
                self._seen.popitem(last=False)
        return press

    def _set(self, arguments: SetRegionsArguments) -> Callable[[], Data]:
        """Check what is asked; the rest is done on the asker's thread. Errors: ValueError, BundleError."""
        bundle, path = self._selection.inspector.bundle, self._selection.path
        if not self._may_sign:
            raise ValueError(
                "this station uses signed bundles alone, and cannot sign: draw with `gelgate bundle regions`, sign the "
                "new bundle, put it in the place of the old one, and reload"
            )
        if self._selection.instead_of is not None:
            raise ValueError(
                "a shadow has taken the place of the configured bundle; configure the one to draw on"
            )
        change = ["--remove", arguments.remove or ""]
        if arguments.add is not None:
            region = DrawnRegion(arguments.add, "ignore", self._find_points(arguments, bundle))
            points = " ".join(f"{x:.3f},{y:.3f}" for x, y in region.points_mm)
            if arguments.kind == "stricter":
                raise ValueError(
                    "what a stricter region costs is counted by nominal presses, which a station has not; where they "
                    f"are: gelgate bundle regions {path} NOMINAL -o NEW --add 'stricter {arguments.add} 1.5 {points}'"
                )
            change = ["--add", f"{arguments.kind} {arguments.add} {points}"]
        return lambda: self._draw(path, bundle, change)

    def _find_points(self, arguments: SetRegionsArguments, bundle: Bundle) -> Points:
        """Bring corners on the picture of a press to the pose of the bank, mm. Errors: ValueError."""
        seen = self._seen.get(arguments.press_id or "")
        if seen is None or seen.fit != _fit_of(bundle):
            raise ValueError(
                f"press {arguments.press_id} is not among the newest {MOST_REMEMBERED} that this bundle has scored; "
                "press the part once more, and draw on that picture"
            )
        if not all(len(point) == 2 for point in arguments.points_mm):
            raise ValueError("points_mm are [x, y], in mm from the top left corner of the press's picture")
        scale, (h, w) = np.array(bundle.profile.mm_per_pixel), bundle.manifest.frame
        corners = np.array(arguments.points_mm, np.float64).reshape(-1, 2)
        if seen.pose is not None:
            back = seen.pose.inverse().matrix((w, h))
            corners = ((corners / scale - 0.5) @ back[:, :2].T + back[:, 2] + 0.5) * scale
        return tuple((float(x), float(y)) for x, y in corners)

    def _draw(self, path: Path, bundle: Bundle, change: list[str]) -> Data:
        """Make the new revision, run it once, put it in the place of the old one, and have it opened. Errors:
        ValueError, BundleError."""
        if not self._drawing.acquire(blocking=False):
            raise ValueError("another region is being drawn; ask again when that has ended")
        new, trunk = path.with_name(f".{path.stem}.drawn{path.suffix}"), (bundle.trunk_sha256 or "",)
        try:
            before = Bundle.load(path, loaded=trunk)  # of a drawing a moment ago, or copied there by a person
            if _fit_of(before) != _fit_of(bundle):
                raise ValueError(
                    f"bundle {path} is another one than the one that inspects; reload, and draw again"
                )
            old = path.with_name(f".{path.stem}.{before.digest[:12]}{path.suffix}")
            _run(["bundle", "regions", str(path), *change, "-o", str(new), "--overwrite", "--threads", "1"])
            try_bundle(new, threads=1)
            made = Bundle.load(new, loaded=trunk)
            self._inherit_proofs(before, made)
            _exchange(path, new, old)
        finally:
            self._drawing.release()
        self._post(self._selection.reload)
        drawn = made.manifest.regions
        return {
            "revision": made.manifest.revision,
            "regions": [region.name for region in drawn.regions] if drawn else [],
            "said": (drawn and drawn.describe()) or "no region is drawn any more",
            "kept": str(old),
        }

    def _inherit_proofs(self, old: Bundle, new: Bundle) -> None:
        """Say of the new revision on each gel what is known of the old one: a drawing proves nothing there. Presses
        prove the new one only where it scores nothing higher, which it may once a region is removed, or is judged,
        too. Errors: StoreError."""
        before, now = (bundle.bank.get(REGION_WEIGHTS, np.float32(1)) for bundle in (old, new))
        change = partial(
            gel_proofs.inherit,
            old_id=old.digest,
            new_id=new.digest,
            time_ns=self._clock.time_ns(),
            with_presses=bool((now <= before).all()),
        )
        self._store.write("taking the proofs of a bundle over to its drawn regions", change)

    commands = (
        Command(
            "set_regions",
            SetRegionsArguments,
            _set,
            "add or remove a region where nothing is judged, or that alone is; a new revision of the bundle in use "
            "is made, which takes some seconds, and opened as by `reload`. `said`: what is ignored; `kept`: where the "
            "revision before stays",
            "the bundle in use",
        ),
    )


def _fit_of(bundle: Bundle) -> tuple[object, ...]:
    """Return what revisions have in common whose bank has the same pose."""
    manifest = bundle.manifest
    return manifest.part, manifest.position, manifest.profile, manifest.region, manifest.registration


def _run(words: list[str]) -> None:
    """Run `gelgate` with these words. Errors: BundleError with its sentence."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "gelgate", *words],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=SECONDS,
            text=True,
            errors="replace",
        )
    except subprocess.TimeoutExpired:
        raise BundleCorrupt(
            f"the regions were not drawn within {SECONDS:g} s; free the machine, and ask again"
        ) from None
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.startswith("gelgate: ")]
        sentence = lines[-1].removeprefix("gelgate: ") if lines else f"exit code {done.returncode}"
        raise ValueError(f"the regions were not drawn: {sentence}")


def _exchange(path: Path, new: Path, old: Path) -> None:
    """Put the new bundle in the place of this one, which stays as `old`. Errors: BundleError."""
    try:
        replace_bundle(path, new, old)
    except OSError as error:
        raise BundleCorrupt(
            f"bundle {path} cannot be replaced: {error.strerror}; allow the gateway to write in {path.parent}, on a "
            "file system that exchanges folders at once, as ext4 does"
        ) from error
