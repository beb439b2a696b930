"""Whether the bundle in use is proven on the mounted gel: found when either changes, and said until it is."""

import logging
from functools import partial
from typing import Final, Self

from edge.core.gel_proof import GelProof, MadeOn
from edge.core.imaging.quality import Reason, Rejection
from edge.core.press import Press, ReferenceLabel
from edge.core.sentence import Sentence
from edge.core.verdict import Kind
from edge.messaging.command_payloads import NoArguments
from edge.model.inspector import Inspector
from edge.model.manifest import Facts
from edge.model.manifest_facts import GEL
from edge.press_stage import Command, Data, Mounted, PressStage, StageParts
from edge.store import gel_proofs
from edge.store.gel_ledger import GelRecord
from edge.store.gel_proofs import GelBundle
from edge.store.person_verdicts import newest_acts
from edge.store.press_archive import ArchiveFolder

__all__ = ["GelProofWatch", "read_origin"]

log = logging.getLogger(__name__)

# `gelgate gel prove` of another process is looked for this often.
LOOK_S: Final = 1.0


class GelProofWatch(PressStage):
    """Counts the presses that prove a bundle on a gel."""

    def __init__(self, parts: StageParts) -> None:
        self._unproven, self._clock = parts.config.gel.unproven, parts.clock
        self._store, self._alarms = parts.store, parts.alarms
        self._made: MadeOn  # `use` comes before the first turn
        self._mounted: Mounted | None = None
        self._sentence: Sentence | None = None
        self._next_look_ns = 0
        self._acts: object = None

    @classmethod
    def open(cls, parts: StageParts) -> Self:
        return cls(parts)

    def use(self, inspector: Inspector) -> None:
        """Take what this bundle says of its own gel."""
        self._made = read_origin(inspector.bundle.manifest)

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

    def record(self, press: Press, gel: GelRecord) -> None:
        """Count a press where a part, or a master piece that must pass, was judged. Errors:
        StoreError."""
        mounted = self._mounted
        label = press.label
        is_sound = label is None or (isinstance(label, ReferenceLabel) and label.expected == Kind.PASS.value)
        if self._sentence is None or mounted is None or not is_sound or press.score is None:
            return
        is_alarm = press.word != Kind.PASS.value
        key = GelBundle(mounted.serial, gel.gel_id, press.bundle_id)
        self._store.write(
            "counting a press on a new gel", partial(gel_proofs.count, key=key, is_alarm=is_alarm)
        )
        self._look(mounted)

    def prove(self, arguments: NoArguments) -> Data:
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
        return {"presses": proof.presses, "alarms": proof.alarms, "rate": proof.rate}

    commands = (
        Command(
            "prove_gel",
            NoArguments,
            prove,
            "a person says that every press on this gel was of a sound part: with enough presses and few alarms the "
            "bundle in use is proven on it. `rate`: the false alarms that they still allow",
            "what the bundle is trusted with",
        ),
    )

    def _look(self, mounted: Mounted) -> None:
        change = partial(
            gel_proofs.see,
            key=_key(mounted),
            part=mounted.part,
            made=self._made,
            time_ns=self._clock.time_ns(),
        )
        proof = self._store.write("reading how far the bundle is proven on this gel", change)
        if proof.proven is None:
            proof = self._read_words(_key(mounted)) or proof
        self._sentence = proof.unproven(_key(mounted).describe(mounted.part), mounted.gel_id)
        self._alarms.set_unproven(self._sentence)
        if self._unproven == "warn":
            self._alarms.say("gel_proof", self._sentence, "warning")
        elif self._unproven == "refuse" and self._alarms.set_fault("gel_proof", self._sentence):
            log.warning("%s", self._sentence)

    def _read_words(self, key: GelBundle) -> GelProof | None:
        """Prove the bundle by what people said, if that is enough; looked at after each act."""
        acts = self._store.read("reading the newest acts", newest_acts), key
        if acts == self._acts:
            return None
        self._acts = acts
        archive = ArchiveFolder(self._store.path.with_suffix(".archive"))
        change = partial(gel_proofs.prove_by_words, key=key, archive=archive)
        return self._store.write("proving a bundle by what people said", change)


def read_origin(manifest: Facts) -> MadeOn:
    """Read what the bundle says of its own gel."""
    gel = manifest.facts.get(GEL)
    gel_id = gel.get("gel_id") if isinstance(gel, dict) else None
    return MadeOn(manifest.provenance.created, gel_id if isinstance(gel_id, str) else None)


def _key(mounted: Mounted) -> GelBundle:
    return GelBundle(mounted.serial, mounted.gel_id, mounted.bundle_id)
