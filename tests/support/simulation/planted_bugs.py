"""Bugs to plant: each is one change of one file, and the words with which an auditor must name it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Bug:
    """old: text that the file has once. new: what stands there instead. sentence: what an auditor says matches it."""

    name: str
    file: str
    old: str
    new: str
    sentence: str


BUGS = (
    Bug(
        "fsync left out",
        "edge/store/database.py",
        "{'FULL' if is_durable else 'NORMAL'}",
        "{'NORMAL'}",
        "results lack|are of no row",
    ),
    Bug(
        "deleted before it is acknowledged",
        "edge/messaging/sink_worker.py",
        "        if row.row_id != self._accepted:\n",
        "        self._outbox.acknowledge(row.row_id, self.name)\n        if row.row_id != self._accepted:\n",
        "results lack|have no picture message",
    ),
    Bug(
        "count outside the transaction",
        "edge/store/press_store.py",
        '        with self._database.writing(f"recording press {press.press_id}") as connection:\n',
        '        with self._database.writing("counting") as connection:\n'
        "            self._count(connection, press)\n"
        '        with self._database.writing(f"recording press {press.press_id}") as connection:\n'
        "            ledger.add_presses(connection, press.serial, press.time_ns, -1)\n",
        "presses, and",
    ),
    Bug(
        "wall clock for ages",
        "edge/gateway/build.py",
        "config.gel.warn_fraction, clock.monotonic_ns)",
        "config.gel.warn_fraction, clock.time_ns)",
        "results lack",
    ),
    Bug(
        "sinks by position",
        "edge/config/loading.py",
        "return [sink.name or _receiver(sink) for sink in sinks]",
        'return [f"{sink.plugin}-{number}" for number, sink in enumerate(sinks)]',
        "results lack",
    ),
    Bug(
        "stale frame scored",
        "edge/model/inspector.py",
        "        if stale:\n",
        "        if False:\n",
        "old when it was judged",
    ),
    Bug(
        "gap not seen",
        "edge/core/contact/press_detector.py",
        "GAP_S: Final = 0.27",
        "GAP_S: Final = 9.0",
        "before an interruption",
    ),
    Bug(
        "press recorded under the next part",
        "edge/gateway/part_selection.py",
        "if not is_pressed and (self.is_waiting",
        "if (self.is_waiting",
        "judged as",
    ),
    Bug(
        "pulse after its deadline",
        "edge/features/outputs/actuator_driver.py",
        "        if now_ns > pulse.start_by_ns:\n            return f",
        "        if False:\n            return f",
        "after its deadline",
    ),
    Bug(
        "a rejected press is shown as a pass",
        "edge/features/outputs/stage.py",
        "        elif press.label is None:\n            self._verdict, self._awaited_ns = press.word, None",
        "        elif press.label is None:\n"
        '            self._verdict, self._awaited_ns = "pass" if press.word == "rejected" else press.word, None',
        "shown",
    ),
    Bug(
        "the verdict stays when the next press begins",
        "edge/features/outputs/stage.py",
        "        if isinstance(event, PressBegan):\n",
        "        if False:\n",
        "shown",
    ),
    Bug(
        "score NaN passes",
        "edge/model/scorer.py",
        "        if not (np.isfinite(score_maps).all() and np.isfinite(scores).all()):\n",
        "        scores = np.nan_to_num(scores, nan=0.0)\n        if False:\n",
        "glaring and passed",
    ),
    Bug(
        "retained state not resent",
        "edge/messaging/sink_worker.py",
        "return [message for _, message in self.since(-1) if message.retain]",
        "return []",
        "retains",
    ),
    Bug(
        "the score ahead of another frame",
        "edge/model/inspector.py",
        "for *asked, press in self._ahead if asked == [frame, touch]), None)",
        "for *asked, press in self._ahead), None)",
        "scores otherwise|passed|has .'pass'., and a pass",
    ),
    Bug(
        "owed pictures forgotten",
        "edge/gateway/pictures.py",
        "for press_id in self._store.owed_pictures():",
        "for press_id in self._store.owed_pictures()[:0]:",
        "have no picture message",
    ),
    Bug(
        "result with the old gel after a replacement",
        "edge/gateway/recorder.py",
        "    gel = recorded.gel\n",
        '    gel = _result.__dict__.setdefault("gel", recorded.gel)\n',
        "gel",
    ),
    Bug(
        "the old gel is pressed on in the ledger",
        "edge/store/gel_ledger.py",
        "    gel_id = gel_id or next(",
        "    if len(ids) > 1:\n        return\n    gel_id = gel_id or next(",
        "gel",
    ),
    Bug(
        "one receiver's acknowledgement is enough",
        "edge/store/outbox.py",
        "row_id = ? AND NOT EXISTS (SELECT 1 FROM sinks WHERE name NOT IN ",
        "row_id = ? AND NOT (1 IN ",
        "results lack|retains the press",
    ),
    Bug(
        "alarms of a killed process stay",
        "edge/messaging/sink_worker.py",
        "        for alarm in list_alarms():\n            self.announce(alarm_cleared(alarm))\n",
        "",
        "retains the alarms",
    ),
    Bug(
        "a late result is not marked",
        "edge/messaging/sink_worker.py",
        "                self._deliver(as_replayed(row.message) if is_late else row.message)\n",
        "                self._deliver(row.message)\n",
        "came late",
    ),
    Bug(
        "the verdict survives a halt",
        "edge/features/outputs/stage.py",
        '        if view.state != "ready":\n            self._verdict = None\n',
        "",
        "was not ready since",
    ),
    Bug(
        "retained messages pile up",
        "edge/store/outbox.py",
        "        if message.retain:\n            forget(",
        "        if False:\n            forget(",
        "of the retained topic",
    ),
    Bug(
        "an act that failed is not chained",
        "edge/store/acts.py",
        "    if updated.rowcount:\n",
        '    if updated.rowcount and outcome == "done":\n',
        "act . was changed",
    ),
    Bug(
        "a new gel is not chained",
        "edge/store/gel_ledger.py",
        "    ledger_chain.append_gels(connection, serial)\n\n\ndef add_presses",
        "\n\ndef add_presses",
        "has no link",
    ),
    Bug(
        "a forged signature is accepted",
        "edge/gateway/commands.py",
        "        if not is_signed(",
        "        if False and not is_signed(",
        "nobody may ask it so",
    ),
    Bug(
        "an earlier count replaces one that was corrected",
        "edge/store/press_store.py",
        "            if sentences:  # an earlier",
        "            if False:  # an earlier",
        "went back",
    ),
    Bug(
        "what is refused of the present state is not said again",
        "edge/messaging/sink_worker.py",
        "again = set(self._unsaid) if",
        "again = set(self._unsaid) if False and",
        "retains",
    ),
    Bug(
        "the second connection is not tried again",
        "plugins/sinks/mqtt.py",
        "        self.find_level()\n        self.find_availability()\n",
        "        self.find_level()\n",
        "alarm receiver",
    ),
    Bug(
        "pictures are not owed",
        "edge/gateway/recorder.py",
        "owes_picture = waiting.drawing is not None",
        "owes_picture = False",
        "have no picture message",
    ),
    Bug(
        "broken frames are a pause of the stream",
        "edge/core/contact/press_detector.py",
        "        if self._came_ns is None or frame",
        "        if True or frame",
        "alarm device",
    ),
)
