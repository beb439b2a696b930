"""Bugs planted by somebody who had not read the simulator; see `planted_bugs.py`."""

from simulation.planted_bugs import Bug

BY_OTHERS = (
    # operations.md, the disk is full: 'presses are still scored and wait in memory; all are recorded when
    # there is room'.
    Bug(
        "a press that the store refuses leaves the queue",
        "edge/gateway/inspection_session.py",
        "                    self._waiting[0] = self._waiting[0].delay()\n",
        "                    self._waiting.popleft()\n",
        "is lost|belongs to no press|were made without one",
    ),
    # operations.md: 'results wait in the outbox, in order, and are sent again until they are acknowledged'.
    Bug(
        "a row that failed is skipped",
        "edge/messaging/sink_worker.py",
        "                    with about_press(_press_id(row.message)):\n"
        "                        self._send(row)\n"
        "                    self._passed = row.row_id\n",
        "                    self._passed = row.row_id\n"
        "                    with about_press(_press_id(row.message)):\n"
        "                        self._send(row)\n",
        "messages still wait|another order|results lack",
    ),
    # mqtt.md: `state`, `alarm` are the current ones: halted, then ready again as at the birth, is not
    # published.
    Bug(
        "a born message is never sent again",
        "plugins/sinks/mqtt.py",
        "if self._born.pop(message.topic, None) == message:",
        "if self._born.get(message.topic) == message:",
        "retains",
    ),
    # operations.md: 'If the gateway ends before, they are counted on the gel at the next start, with the
    # alarm counts'.
    Bug(
        "presses of a full disk are forgotten at a kill",
        "edge/gateway/station_loop.py",
        "        if self.is_halted and self.session is not None:\n"
        "            parts.store.note_uncounted(self.session.gel.serial, self.session.unrecorded)\n",
        "",
        "presses more than rows|were lost, and no alarm says so",
    ),
    # operations.md: 'Another port is fine, another sensor during a run is refused'; wear is counted on the
    # other's gel.
    Bug(
        "another sensor is accepted during a run",
        "edge/acquisition.py",
        "        if known is not None and device.identity.serial != known.serial:\n",
        "        if known is not None and device.identity.product != known.product:\n",
        "another sensor|alarm device|nothing is seen",
    ),
    # contact.md: 'A press lasts until the gel has been seen free, also over an unplugged sensor: not scored
    # or counted again'.
    Bug(
        "a press ends at an interruption",
        "edge/core/contact/table.py",
        "_row(State.CONTACT, CLEAR=State.RELEASE, INVERSE=State.DOUBT,",
        "_row(State.CONTACT, CLEAR=State.RELEASE, INVERSE=State.DOUBT, GAP=State.NO_CONTACT,",
        "was judged|has . rows|alarm contact",
    ),
    # operations.md: 'the machine starts again: it inspects the part that was selected last'.
    Bug(
        "the selected part is forgotten at a restart",
        "edge/store/bundles_in_use.py",
        'ON CONFLICT (one) DO UPDATE SET part = excluded.part, "\n        "position = excluded.position",',
        'ON CONFLICT (one) DO NOTHING",',
        "judged as|inspects",
    ),
    # operations.md: 'a relay board is unplugged: it is opened again when it is back, and every output is
    # written'.
    Bug(
        "the outputs are not written again",
        "edge/features/outputs/actuator_driver.py",
        "            self._written, self._on_until_ns = {}, {}\n            self._connection.lost(error)\n",
        "            self._on_until_ns = {}\n            self._connection.lost(error)\n",
        "a pass is shown|lamp|are shown at once|relay: .*overload is shown",
    ),
    # mqtt.md: 'The same verb and transaction id within a minute are the same request: it is not done twice'.
    Bug(
        "a repeated request is done again",
        "edge/store/press_store.py",
        "after_ns = now_ns - int(within_s * 1e9)",
        "after_ns = now_ns - int(within_s * 1e6)",
        "was done . times",
    ),
    # mqtt.md: state `stopped: ended on purpose`; the broker publishes the will `lost` over it.
    Bug(
        "the intended end is a loss",
        "plugins/sinks/mqtt.py",
        "            connection.close()\n        self._requests.close()\n",
        '            connection.abandon("closed here")\n        self._requests.close()\n',
        "ended in order",
    ),
    # operations.md, Gel change: 'Leave the gel free until `state` is `ready` again: its picture is learnt'.
    Bug(
        "a gel change leaves the old picture",
        "edge/gateway/inspection_session.py",
        "                stage.mount(gel)\n            self.relearn()\n",
        "                stage.mount(gel)\n",
        "ready at once",
    ),
    # security.md: the newest presses are in the archive, and each is replayed from it.
    Bug(
        "objects of the archive that are shared are removed",
        "edge/store/press_archive.py",
        "if uses[digest] == 0]",
        "if uses[digest] <= 1]",
        "archive",
    ),
    # mqtt.md, architecture.md: where the broker refuses the second connection `availability` is emptied:
    # `online` would stay for ever.
    Bug(
        "online without a will",
        "plugins/sinks/mqtt_availability.py",
        " or self.is_held:\n            return message\n",
        " or self._is_wanted:\n            return message\n",
        "online",
    ),
    # operations.md: 'a pass goes out after half a second without a picture of the gel'.
    Bug(
        "a pass stays while nothing is seen",
        "edge/features/outputs/stage.py",
        "UNSEEN_S: Final = 0.5",
        "UNSEEN_S: Final = 5.0",
        "a pass (is|was) shown",
    ),
    # operations.md: '`gelgate station acts` keeps each time without sight (`not_seen`)'.
    Bug(
        "time without sight is not kept",
        "edge/features/sensing_watch.py",
        "            self._note_unseen((timestamp_ns - self._seen_ns) / 1e9)\n            self._seen_ns",
        "            self._seen_ns",
        "not in the acts",
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
        "            self._deliver(as_replayed(row.message) if is_late else row.message)\n",
        "            self._deliver(row.message)\n",
        "came late",
    ),
    Bug(
        "the verdict survives a halt",
        "edge/features/outputs/stage.py",
        '        if view.state != "ready":\n            self._verdict, self._awaited_ns = None, None\n',
        "",
        "was not ready since",
    ),
    Bug(
        "retained messages pile up",
        "edge/store/outbox.py",
        "        if message.retain:\n            forget(",
        "        if False:\n            forget(",
        "of the retained topic|retained on gel went back",
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
        "    ledger_chain.append_gels(connection, serial)\n\n\ndef _find_known",
        "\n\ndef _find_known",
        "has no link",
    ),
    # operations.md: 'A pulse starts within deadline_ms of the judged frame; or not at all: alarm `pulse`'.
    Bug(
        "no damaged part is thrown out",
        "edge/features/outputs/stage.py",
        "        if press.shown is not None:\n            for driver",
        '        if press.shown == "pass":\n            for driver',
        "its pulse on channel 2",
    ),
)
