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


def _silence(alarm: str) -> Bug:
    """Plant that the station never raises this alarm, and does all else that it does then."""
    old = "if self._raised.get(alarm) == (sentence and (sentence, severity)):"
    new = old.replace("if ", f'if alarm == "{alarm}" or ')
    return Bug(
        f"the alarm {alarm} is silent",
        "edge/gateway/status.py",
        old,
        new,
        f"the alarm {alarm} is not raised",
    )


SILENT = (
    "free_gel",
    "gel",
    "gel_expired",
    "gel_proof",
    "gel_mark",
    "drift",
    "false_alarms",
    "piece",
    "shadow",
    "takeover",
    "press_again",
    "gel_scar",
)
"""Alarms that nothing else plants."""

BUGS = (
    *map(_silence, (*SILENT, "disk", "archive", "refused", "receiver", "overload", "overview", "golden")),
    Bug(
        "fsync left out",
        "edge/store/database.py",
        "{'FULL' if is_durable else 'NORMAL'}",
        "{'NORMAL'}",
        "results lack|are of no row|is lost|and a pass is shown",
    ),
    Bug(
        "a line of the file is not synced",
        "plugins/sinks/jsonl.py",
        "                os.fsync(file.fileno())\n            except OSError:\n",
        "                pass\n            except OSError:\n",
        "the file: .* results lack|that was sent is lost|of the file is not JSON",
    ),
    Bug(
        "deleted before it is acknowledged",
        "edge/messaging/sink_worker.py",
        "        if self._was_slow:\n",
        "        self._outbox.acknowledge([row.row_id], self.name)\n        if self._was_slow:\n",
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
        "presses, and|presses more than rows",
    ),
    Bug(
        "wall clock for ages",
        "edge/gateway/build.py",
        "config.gel.warn_fraction, clock.monotonic_ns)",
        "config.gel.warn_fraction, clock.time_ns)",
        "results .*lack",
    ),
    Bug(
        "sinks by position",
        "edge/config/loading.py",
        "return [sink.name or _receiver(sink) for sink in sinks]",
        'return [f"{sink.plugin}-{number}" for number, sink in enumerate(sinks)]',
        "results lack|have no picture message",
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
        " an interruption|nothing is seen",
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
        "        if now_ns > pulse.start_by_ns:\n            return S",
        "        if False:\n            return S",
        "after its deadline|pulse .* belongs to no press",
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
        "is glaring",
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
        "scores otherwise|passed|has .'pass'., and a pass|sound, has the verdict fail",
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
        "    gel_id = gel_id or f",
        "    if len(ids) > 1:\n        return\n    gel_id = gel_id or f",
        "gel",
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
        "if recover(connection, self.path, self._counts.read().get(serial), serial, time_ns):",
        "if recover(connection, self.path, self._counts.read().get(serial), serial, time_ns) and False:",
        "went back",
    ),
    Bug(
        "presses that a full disk has cost are not said",
        "edge/store/press_counts.py",
        "SELECT sentence FROM corrected_counts ORDER",
        "SELECT sentence FROM corrected_counts WHERE sentence NOT LIKE '%refused writes%' ORDER",
        "were lost, and no alarm says so",
    ),
    Bug(
        "pictures are not owed",
        "edge/gateway/recorder.py",
        "owes_picture = waiting.drawing is not None",
        "owes_picture = False",
        "have no picture message",
    ),
    Bug(
        "what was dropped before a start is forgotten",
        "edge/store/outbox.py",
        '            connection.execute("DELETE FROM sinks")\n',
        '            connection.execute("DELETE FROM sinks")\n'
        '            connection.execute("UPDATE dropped SET acknowledged = rows")\n',
        "were dropped .* no alarm says so",
    ),
    Bug(
        "the archive keeps every press",
        "edge/store/press_archive.py",
        "            len(self._presses) > self.most_presses or",
        "            False or",
        "presses are in an archive",
    ),
    Bug(
        "the archive keeps the files of removed presses",
        "edge/store/press_archive.py",
        "if uses[digest] == 0]",
        "if uses[digest] < 0]",
        "files that no press needs",
    ),
    Bug(
        "what a power cut damaged of shared files stays",
        "edge/store/press_archive.py",
        "_holds(path, data) if digest in self._unread else ",
        "",
        "is not in the archive",
    ),
    Bug(
        "what was scored ahead is never let go",
        "edge/model/inspector.py",
        "        return self._ahead[-1][2]\n",
        '        self.__dict__.setdefault("all", []).append(self._ahead[-1])\n        return self._ahead[-1][2]\n',
        "are in memory",
    ),
    Bug(
        "the contact stays when nothing is seen",
        "edge/features/contact_state.py",
        "        if now_ns - self._seen_ns <= GAP_S * 1e9:\n",
        "        if True:\n",
        "nothing is seen .*(lift|free) is shown|lift was shown",
    ),
    Bug(
        "the next press may be lifted with the word of the last",
        "edge/core/contact_state.py",
        "            self.press_id, self._is_recorded = None, False\n"
        "        elif isinstance(event, PressSettled) and event.is_held and not self._is_overloaded:\n"
        '            self.state = "at_rest"',
        "            self.press_id = None\n"
        "        elif isinstance(event, PressSettled) and event.is_held and not self._is_overloaded:\n"
        '            self.state = "lift" if self._is_recorded else "at_rest"',
        "lift was shown .* not recorded yet|lift of the press .*, which is not recorded",
    ),
    Bug(
        "a PLC is answered by the press that is held",
        "edge/core/handshake.py",
        "self._is_touched, self._is_command\n",
        "self._is_touched, True\n",
        "had begun before it|no press after it|has the verdict rejected, without any fault",
    ),
    Bug(
        "a pass stays at a PLC when the station halts",
        "edge/core/handshake.py",
        '(self._view.step == "busy" or self._view.is_pass)',
        '(self._view.step == "busy")',
        "and a pass is shown",
    ),
    Bug(
        "a PLC waits for ever",
        "edge/core/handshake.py",
        "now_ns - self._trigger_ns >= self._timeout_ns",
        "False",
        "it is busy for",
    ),
    Bug(
        "two PLCs write",
        "plugins/handshakes/modbus.py",
        "        if self._writer is not None and is_heard and not self._writer.is_gone:\n",
        "        if False:\n",
        "as 10.0.0.1 did",
    ),
    Bug(
        "a piece passes with a place missing",
        "edge/core/piece.py",
        'return "incomplete" if self.missing else "pass"',
        'return "pass"',
        "is pass: its places are",
    ),
    Bug(
        "a pass of one place is shown",
        "edge/core/piece.py",
        '        if word != "pass" or (self.is_last and not self.has_failed):\n',
        "        if True:\n",
        "a pass (is|was) shown",
    ),
    Bug(
        "the result of an incomplete piece is not sent",
        "edge/store/pieces.py",
        "    outbox.put(connection, [message],",
        '    outbox.put(connection, [message] if piece.verdict != "incomplete" else [],',
        "the results of .* lack",
    ),
    Bug(
        "the pass of a piece stays when the next one is begun",
        "edge/features/outputs/stage.py",
        "is_other_piece = view.piece_id not in (None, self._piece_id)",
        "is_other_piece = False",
        "a pass of the piece before is shown",
    ),
    Bug(
        "an overload raises no alarm",
        "edge/features/contact_state.py",
        '        if follower.state == "overload" and not self._is_overloaded:\n',
        "        if False:\n",
        "alarm gel_overload is not raised",
    ),
    Bug(
        "a robot at a broker is told of a change with the next repetition",
        "edge/features/contact_state.py",
        "        if state == self._said and now_ns",
        "        if now_ns",
        "broker.: (press .* is (held|over), and|lift of |nothing is seen for .* (lift|free) is shown)",
    ),
    Bug(
        "two sessions call methods",
        "plugins/handshakes/opcua.py",
        "        if (sentence := self._refuse_writer()) is not None:\n",
        "        if (sentence := self._refuse_writer()) is not None and False:\n",
        "as 10.0.0.1 did",
    ),
    Bug(
        "a press of another piece answers a trigger",
        "edge/core/handshake.py",
        '        if piece is not None and self._view.piece not in ("", piece):\n',
        "        if False:\n",
        "was answered by a press of",
    ),
    Bug(
        "what lies there after an interruption is the free gel",
        "edge/features/scars.py",
        'None if look.phase == "unseen" else look.level',
        "look.level",
        "no gel has a scar",
    ),
    Bug(
        "a press of a place that comes later fills another one",
        "edge/features/handshake/stage.py",
        "        if is_new:\n            try:\n",
        "        self.admit = lambda press: press  # type: ignore[method-assign]\n"
        "        if part is not None:\n            self._select(part, trigger)\n            part = None\n"
        "        if is_new:\n            try:\n",
        "lay at .*, and its .* is of",
    ),
    Bug(
        "a press of another part answers a trigger",
        "edge/core/handshake.py",
        "        if self._part not in (None, part):\n",
        "        if False:\n",
        "was selected before its press|judged as another part",
    ),
    Bug(
        "what a turn has judged for seconds may be lifted",
        "edge/features/contact_state.py",
        "self._seen_ns = self._taken_ns",
        "self._seen_ns = self._clock.monotonic_ns()",
        "the loop hung since its press was seen|and press .* was not recorded yet",
    ),
    Bug(
        "one view of the free gel ends a doubt",
        "edge/core/contact_state.py",
        "self._is_doubtful = self.press_id is not None",
        "self._is_doubtful = False",
        "the loop hung since its press was seen|and press .* was not recorded yet",
    ),
    Bug(
        "a lock is not waited for",
        "edge/store/database.py",
        "BUSY_TIMEOUT_S: Final = 5.0",
        "BUSY_TIMEOUT_S: Final = 0.0",
        "is locked for .* s, and the alarm store is raised",
    ),
    Bug(
        "a lock is waited for as long as it lasts",
        "edge/store/database.py",
        "BUSY_TIMEOUT_S: Final = 5.0",
        "BUSY_TIMEOUT_S: Final = 25.0",
        "waits for a locked database, and the alarm store is not raised",
    ),
    Bug(
        "a damaged part that has passed is not said",
        "edge/features/person_verdicts.py",
        "if is_called_damaged(words)]",
        "if is_called_damaged(words[:0])]",
        "the alarm escape is not raised",
    ),
    Bug(
        "an old still counts for the next part",
        "edge/features/overview.py",
        "now_ns - waiting.timestamp_ns <= longest_ns",
        "longest_ns > 0",
        "the overview camera has not seen its part",
    ),
    Bug(
        "the code on a part selects for the press after it",
        "edge/features/overview.py",
        "self._selection.select(part, why, is_pressed=False)",
        "self._selection.select(part, why, is_pressed=True)",
        "has the verdict rejected, without any fault",
    ),
    Bug(
        "a master piece is judged as a part",
        "edge/features/reference_press.py",
        "armed.is_void else armed.label",
        "not armed.is_void else armed.label",
        "is of the master piece, and has",
    ),
    Bug(
        "a snapshot has its name before it is complete",
        "edge/features/snapshots.py",
        'unfinished = folder.with_name(f".{folder.name}")',
        "unfinished = folder",
        "the snapshot .* is not complete|is done, and is not there",
    ),
    Bug(
        "a shadow without a promise takes over",
        "edge/features/shadow.py",
        "        if refusals:\n",
        "        if len(refusals) > 8:\n",
        "a shadow that passes everything may take over|and is of no whole bundle",
    ),
    Bug(
        "a new gel needs no master piece",
        "edge/features/reference_press.py",
        "(newest.gel_id, newest.bundle_id) != (mounted.gel_id, mounted.bundle_id)",
        "newest.bundle_id != mounted.bundle_id",
        "the alarm reference is not raised",
    ),
    Bug(
        "a bundle that has changed under its manifest stays",
        "edge/gateway/opening.py",
        "            self._check_age(Bundle.load(one.path, trust=trust), table)\n",
        "",
        "the alarm bundle is not raised",
    ),
    Bug(
        "a bundle is exchanged during a press",
        "edge/gateway/part_selection.py",
        "            if not is_pressed and (self.is_waiting or",
        "            if True and (self.is_waiting or",
        "is judged by bundle|another part was selected at its begin",
    ),
    Bug(
        "a bundle with a fault leaves its place empty",
        "edge/gateway/opening.py",
        "                        if earlier and before.may_inspect(earlier)\n",
        "                        if False\n",
        "cannot be selected|is still raised|retains the state|was to be opened",
    ),
    Bug(
        "of two sensors one is taken",
        "plugins/devices/uvc/identity.py",
        "    if len(chosen) == 1:\n        return chosen[0]\n",
        "    if chosen:\n        return chosen[-1]\n",
        "of two sensors the station has opened one",
    ),
    # mqtt.md: 'a request that is sent while the station is not connected is lost'.
    Bug(
        "a session is kept at the broker",
        "edge/messaging/mqtt_connection.py",
        "clean_session=None if is_5 else True",
        "clean_session=None if is_5 else False",
        "while nobody listened",
    ),
    # operations.md: 'the acts have what else of the configuration waits for a restart'.
    Bug(
        "what waits for a restart is not said",
        "edge/gateway/opening.py",
        "left=_find_left(at_start, now)",
        "left=()",
        "stats_s is",
    ),
    Bug(
        "a reload takes the configuration of the start",
        "edge/gateway/build.py",
        "opener.open_again(config, read_again(), in_use)",
        "opener.open_again(config, config, in_use)",
        "in a configuration|was to be opened|stats_s is",
    ),
    # contact.md: 'with external triggers (command, pedal) it waits: the first frame at rest from the trigger on is
    # scored'; operations.md: `trigger` asks for the verdict.
    Bug(
        "a pedal is heard once",
        "edge/features/outputs/trigger_reader.py",
        "        self._has_fired = self._is_down\n        return self._is_down\n",
        "        is_fired, self._has_fired = self._is_down and not self._has_fired, True\n        return is_fired\n",
        "has the verdict rejected, without any fault",
    ),
    Bug(
        "a page keeps its verdict over a halt",
        "edge/page/shown.py",
        "                    self._forget_verdict()\n                self._status[message.topic] = status\n",
        "                    pass\n                self._status[message.topic] = status\n",
        "the page shows a pass of press .*, and the station was not ready",
    ),
    Bug(
        "a page takes requests of other pages",
        "edge/page/changes.py",
        '    if site not in ("same-origin", "none") or (origin is not None and _origin(origin) != own):\n',
        '    if site not in ("same-origin", "none"):\n',
        "a request of another page is answered by 200",
    ),
    Bug(
        "level fallback on silence",
        "edge/messaging/mqtt_connection.py",
        '                cls(broker, "3.1.1", None, None, lambda: None).close()\n',
        '                return make(broker, "3.1.1")\n',
        "speaks 5, and was connected to at 3.1.1",
    ),
)
