"""Whether the bundle in use is proven on the mounted gel: found when either changes, and said until it is."""

from functools import partial
from typing import Final, Literal

from edge.core.gel_proof import GelProof
from edge.core.imaging.quality import Reason, Rejection
from edge.core.ports import Clock
from edge.core.press import Press
from edge.core.press_label import ReferenceLabel
from edge.core.verdict import Kind
from edge.gateway.press_stage import Mounted, PressStage
from edge.gateway.recorder import PressReport
from edge.gateway.status import StationStatus
from edge.store import gel_proofs
from edge.store.gel_proofs import GelBundle
from edge.store.press_store import Store

__all__ = ["GelProofWatch"]

# `gelgate gel prove` of another process is looked for this often.
LOOK_S: Final = 1.0


class GelProofWatch(PressStage):
    """Counts the presses that prove a bundle on a gel.

    unproven: what happens while a bundle is not proven: `off`, `warn` or `refuse`.
    """

    def __init__(
        self, unproven: Literal["off", "warn", "refuse"], store: Store, status: StationStatus, clock: Clock
    ) -> None:
        self._unproven = unproven
        self._store = store
        self._status = status
        self._clock = clock
        self._mounted: Mounted | None = None
        self._sentence: str | None = None
        self._next_look_ns = 0

    def turn(self, mounted: Mounted | None) -> None:
        """Look again when gel or bundle is another one, and now and then while it is not proven."""
        if mounted is None:
            return
        now_ns = self._clock.monotonic_ns()
        is_same = self._mounted is not None and _key(self._mounted) == _key(mounted)
        if is_same and (self._sentence is None or now_ns < self._next_look_ns):
            return
        self._look(mounted)
        self._mounted, self._next_look_ns = mounted, now_ns + round(LOOK_S * 1e9)

    def admit(self, press: Press) -> Press:
        """Reject a part while the bundle is not proven, where that is configured."""
        if press.label is not None or self._unproven != "refuse" or self._sentence is None:
            return press
        return press.reject(Rejection(Reason.GEL_PROOF, self._sentence))

    def record(self, report: PressReport) -> None:
        """Count a press where a part, or a master piece that must pass, was judged. Errors:
        StoreError."""
        mounted = self._mounted
        bundle_id = report.result.bundle_id
        if self._sentence is None or mounted is None or bundle_id is None or not _is_counted(report):
            return
        is_alarm = report.result.verdict is not Kind.PASS
        key = GelBundle(mounted.serial, report.gel.gel_id, bundle_id)
        self._store.write(
            "counting a press on a new gel", partial(gel_proofs.count, key=key, is_alarm=is_alarm)
        )
        self._look(mounted)

    def prove(self) -> GelProof:
        """A person says that all presses on this gel were of sound parts. Errors: ValueError with what is missing;
        StoreError."""
        mounted = self._mounted
        if mounted is None:
            raise ValueError(
                "no frame has arrived from a sensor yet, so its gel is not known; try again later"
            )
        change = partial(gel_proofs.prove, key=_key(mounted), part=mounted.part)
        proof = self._store.write("proving a bundle on a gel", change)
        self._look(mounted)
        return proof

    def _look(self, mounted: Mounted) -> None:
        change = partial(
            gel_proofs.see,
            key=_key(mounted),
            part=mounted.part,
            made=mounted.made,
            time_ns=self._clock.time_ns(),
        )
        proof = self._store.write("reading how far the bundle is proven on this gel", change)
        before, self._sentence = (
            self._sentence,
            proof.unproven(_key(mounted).describe(mounted.part), mounted.gel_id),
        )
        if before != self._sentence:
            self._status.gel_proof(self._sentence, self._unproven)


def _key(mounted: Mounted) -> GelBundle:
    return GelBundle(mounted.serial, mounted.gel_id, mounted.bundle_id)


def _is_counted(report: PressReport) -> bool:
    label = report.label
    is_sound = label is None or (isinstance(label, ReferenceLabel) and label.expected == Kind.PASS.value)
    return is_sound and report.result.verdict in (Kind.PASS, Kind.FAIL, Kind.UNSURE)
