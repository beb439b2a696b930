"""A verdict made again, from the archived camera bytes and the bundle with the recorded hash: bit for bit, or not."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge.core.contact.mask import Touch
from edge.core.errors import ArchiveError, BundleError
from edge.core.imaging.followed_light import FollowedLight
from edge.core.imaging.frames import CameraFrame
from edge.core.ports import Clock
from edge.core.press import Press, ScarFindings
from edge.core.press_again import is_asked, second_verdict, unsure
from edge.core.verdict import Blame, Cause
from edge.features.scars import mask_scars
from edge.model.archive import MANIFEST, open_archive
from edge.model.bundle import MAX_MANIFEST_BYTES, Bundle
from edge.model.inspector import Inspector
from edge.model.scorer import Scorer
from edge.model.session import fingerprint, how_they_differ
from edge.store.press_archive import ArchivedPress, ArchiveFolder, map_bytes

__all__ = ["Bundles", "Replayed", "judge_again", "judge_as_then"]


# The cause depends on the presses before; the ledger has it.
_AS_THEN = Blame(Cause.UNSURE, "see the recorded result")


@dataclass(frozen=True)
class Replayed:
    """One press, judged again."""

    then: ArchivedPress
    now: Press
    differences: tuple[str, ...] = ()
    """From what was archived, one sentence each; none where verdict, score and score map are equal bit for bit."""
    machine: tuple[str, ...] = ()
    """What is not as it was, as far as it may change a score."""

    @property
    def is_equal(self) -> bool:
        return not self.differences


class Bundles:
    """Bundles by the hash of their manifest, opened at first use, with the threads that scored then.

    paths: bundles, and folders of bundles.
    """

    def __init__(self, paths: Iterable[Path], clock: Clock) -> None:
        self._clock = clock
        self._paths: dict[str, Path] = {}
        self._looked_at: list[Path] = []
        self._open: dict[tuple[str, int], Inspector] = {}
        for path in paths:
            for bundle in _bundles_at(path):
                self._looked_at.append(bundle)
                self._paths.setdefault(_digest(bundle), bundle)

    def inspector(self, press: ArchivedPress) -> Inspector:
        """Open the bundle that judged this press. Errors: ArchiveError where it is not there, BundleError."""
        path = self._paths.get(press.bundle_id)
        if path is None:
            revision = "" if press.revision is None else f", revision {press.revision}"
            raise ArchiveError(
                f"the bundle of press {press.press_id} is not there: {press.bundle_id} ({press.part}/"
                f"{press.position or '-'}{revision}); looked at {', '.join(map(str, self._looked_at)) or 'none'}; name "
                "the bundle, or the folder where old ones are kept, with --bundles"
            )
        key = (press.bundle_id, press.threads)
        if key not in self._open:
            self._open[key] = Inspector(Scorer(Bundle.load(path), press.threads), self._clock)
        return self._open[key]


def judge_again(press: ArchivedPress, archive: ArchiveFolder, inspector: Inspector) -> Replayed:
    """Judge it again with this inspector, and compare. Errors: ArchiveError for what is gone or damaged."""
    now = judge_as_then(press, archive, inspector)
    differences = tuple(_differences(press, now, archive))
    return Replayed(press, now, differences, tuple(_machine(press, archive)) if differences else ())


def judge_as_then(press: ArchivedPress, archive: ArchiveFolder, inspector: Inspector) -> Press:
    """Judge it again with this inspector. Errors: ArchiveError for what is gone or damaged."""
    frame = archive.read(press.frame, f"the judged frame of press {press.press_id}")
    _light_as_then(press, archive, inspector)
    now = inspector.inspect(CameraFrame(frame, 0, 0, is_on_demand=True), Touch(*press.touch))
    now = _without_scars(press, now, archive, inspector)
    if inspector.bundle.digest == press.bundle_id:
        now = _with_the_other_press(press, now, inspector).distrust()
    return now


def _light_as_then(press: ArchivedPress, archive: ArchiveFolder, inspector: Inspector) -> None:
    """Follow the light as it was followed then; a bundle of another fit follows it by the free gel of then."""
    if inspector.bundle.digest == press.bundle_id or (free := archive.read_reference(press)) is None:
        inspector.set_light(None if press.light is None else FollowedLight(*press.light))
    else:
        inspector.new_gel = free if press.light is not None and len(press.light) > 2 else None
        inspector.follow_light(free)


def _without_scars(press: ArchivedPress, now: Press, archive: ArchiveFolder, inspector: Inspector) -> Press:
    """The places that were not judged then are not judged now."""
    if press.masked is None or now.score_map is None or press.map_shape != now.score_map.shape:
        return now
    places = archive.read_masked(press)
    return mask_scars(now, ScarFindings(_AS_THEN, places, is_too_blind=press.is_too_blind), inspector.bundle)


def _with_the_other_press(press: ArchivedPress, now: Press, inspector: Inspector) -> Press:
    """The verdict of a press that asked for a second one, or is the second one, by the same rule as then."""
    verdict = now.verdict
    if verdict is None or verdict.score is None:
        return now
    if is_asked(verdict, press.asked_up_to):
        return replace(now, verdict=unsure(verdict))
    if press.first_score is None:
        return now
    both_score = None if press.own_score is None else press.score
    decide = inspector.bundle.manifest.decide
    return replace(now, verdict=second_verdict(verdict, press.first_score, both_score, decide))


def _differences(press: ArchivedPress, now: Press, archive: ArchiveFolder) -> Iterator[str]:
    verdict = now.verdict
    if now.word != press.verdict:
        yield f"verdict {press.verdict} then, {now.word} now"
    score = verdict.score if verdict else None
    if score != press.score:
        yield _of_scores(press.score, score)
    if (now.reason, now.error) != (press.reason, press.error):
        yield f"reason {press.reason or press.error} then, {now.reason or now.error} now"
    map_sha256 = None if now.score_map is None else hashlib.sha256(map_bytes(now.score_map)).hexdigest()
    if map_sha256 != press.score_map:
        yield _of_maps(press, now.score_map, archive)


def _of_scores(then: float | None, now: float | None) -> str:
    if then is None or now is None:
        return f"score {then} then, {now} now"
    steps = abs(now - then) / float(np.spacing(np.float32(abs(then))))
    return f"score {then:.9g} then, {now:.9g} now: {now - then:+.3g}, {steps:.3g} steps of float32"


def _of_maps(press: ArchivedPress, now: NDArray[np.float32] | None, archive: ArchiveFolder) -> str:
    """Say where two score maps differ and by how much, as far as the archived map is there."""
    if now is None or press.score_map is None or press.map_shape is None:
        return f"a score map {'then' if now is None else 'now'} alone"
    if now.shape != press.map_shape:
        return f"score map of {press.map_shape} (h, w) then, {now.shape} now"
    try:
        before = archive.read_map(press)
    except ArchiveError as error:
        return f"the score map has another SHA-256; where it differs cannot be said: {error}"
    change = now.astype(np.float64) - before
    row, column = np.unravel_index(int(np.abs(change).argmax()), change.shape)
    return (
        f"score map differs at {int(np.count_nonzero(change))} of {change.size} pixels, most at x {column}, y {row} "
        f"of the region: {change[row, column]:+.3g}"
    )


def _machine(press: ArchivedPress, archive: ArchiveFolder) -> Iterator[str]:
    try:
        then: Mapping[str, Any] = json.loads(archive.read(press.machine, "the fingerprint of the machine"))
    except ArchiveError as error:
        yield f"what judged it then is not known: {error}"
        return
    differences = list(how_they_differ(then, fingerprint(press.threads)))
    yield from differences
    if not differences:
        yield "program, onnxruntime, processor and threads are as they were: look for faulty memory"


def _bundles_at(path: Path) -> list[Path]:
    """The bundle at this path, or those in this folder. Errors: ArchiveError for a path that is not there."""
    if not path.exists():
        raise ArchiveError(f"{path} does not exist; name a bundle, or a folder of bundles")
    if path.suffix == ".zip" or (path / MANIFEST).is_file():
        return [path]
    inside = sorted(path.iterdir()) if path.is_dir() else []
    return [press for press in inside if press.suffix == ".zip" or (press / MANIFEST).is_file()]


def _digest(path: Path) -> str:
    """The identity of the bundle there; empty where it cannot be read, and then it is not the one."""
    try:
        return hashlib.sha256(open_archive(path).read(MANIFEST, MAX_MANIFEST_BYTES)).hexdigest()
    except BundleError:
        return ""
