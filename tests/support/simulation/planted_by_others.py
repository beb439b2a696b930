"""Bugs planted by somebody who had not read the simulator; see `planted_bugs.py`."""

from simulation.planted_bugs import Bug

BY_OTHERS = (
    # operations.md: 'a broker that hangs: level 5 or nothing'; at 3.1.1 only where it answers between two
    # silences.
    Bug(
        "level fallback on silence",
        "edge/messaging/mqtt_connection.py",
        "        except LevelRefused:\n"
        '            return make(broker, "3.1.1")\n'
        "        except NoAnswer as silence:\n",
        "        except (LevelRefused, NoAnswer):\n"
        '            return make(broker, "3.1.1")\n'
        "        except RuntimeError as silence:\n",
        "speaks 5",
    ),
    # mqtt.md: '`last/press` and `gel` never go back in time' (two receivers at different rows, then a new
    # connection).
    Bug(
        "an older row becomes the retained state",
        "edge/messaging/sink_worker.py",
        "if row_id > self._rows.get",
        "if row_id != self._rows.get",
        "went back",
    ),
    # operations.md, the disk is full: 'presses are still scored and wait in memory; all are recorded when
    # there is room'.
    Bug(
        "a press that the store refuses leaves the queue",
        "edge/gateway/inspection_session.py",
        "            with about_press(self._waiting[0].row.press_id):\n"
        "                report = self._recorder.record(self._waiting[0])\n"
        "            recorded = self._waiting.popleft()\n",
        "            recorded = self._waiting.popleft()\n"
        "            with about_press(recorded.row.press_id):\n"
        "                report = self._recorder.record(recorded)\n",
        "is lost|belongs to no press",
    ),
    # operations.md: 'results wait in the outbox, in order, and are sent again until they are acknowledged'.
    Bug(
        "a row that failed is skipped",
        "edge/messaging/sink_worker.py",
        "                with about_press(_press_id(row.message)):\n"
        "                    self._send(row)\n"
        "                self._passed = row.row_id\n",
        "                self._passed = row.row_id\n"
        "                with about_press(_press_id(row.message)):\n"
        "                    self._send(row)\n",
        "messages still wait|another order|results lack",
    ),
    # operations.md: 'silence on one message: it is never set aside'.
    Bug(
        "silence counts as a strike",
        "plugins/sinks/mqtt_strikes.py",
        "            self._silent = _one_more(self._silent, message)\n            return\n",
        "            self._silent = _one_more(self._silent, message)\n",
        "another order|were refused",
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
    # mqtt.md: 'A result arrives at least once': a PUBACK with another id removes a row that nobody has.
    Bug(
        "any acknowledgement is taken for this message",
        "edge/messaging/mqtt_connection.py",
        "        self._await(lambda: mid in self._answers or self._is_lost, self.broker.timeout_s)\n"
        "        with self._changed:\n"
        "            if mid in self._answers:\n"
        "                return self._answers.pop(mid)\n",
        "        self._await(lambda: bool(self._answers) or self._is_lost, self.broker.timeout_s)\n"
        "        with self._changed:\n"
        "            if self._answers:\n"
        "                return self._answers.popitem()[1]\n",
        "results lack|retains|picture message",
    ),
    # operations.md: 'If the gateway ends before, they are counted on the gel at the next start, with the
    # alarm counts'.
    Bug(
        "presses of a full disk are forgotten at a kill",
        "edge/gateway/station_loop.py",
        "        if self.is_halted and self.session is not None:\n"
        "            parts.store.note_uncounted(self.session.gel.serial, self.session.unrecorded)\n",
        "",
        "has . presses|presses, and",
    ),
    # gel.md, operations.md: the count of a gel is the presses that were made; these are counted twice.
    Bug(
        "uncounted presses are counted at every start",
        "edge/store/press_counts.py",
        "                counts[serial] = replace(count, order=order)\n",
        "                kept = counts.get(serial, count)\n"
        "                counts[serial] = replace(count, order=order, uncounted=count.uncounted or kept.uncounted)\n",
        "presses, and",
    ),
    # operations.md: 'the same bytes twice: dropped'; a frozen sensor is a fault, not `ready` with every
    # opening.
    Bug(
        "the frozen frame counts as new after an opening",
        "edge/acquisition.py",
        "        self._corrupt_in_a_row, self._last_ns = 0, self._clock.monotonic_ns()\n",
        "        self._corrupt_in_a_row, self._last_ns = 0, self._clock.monotonic_ns()\n"
        "        self._freshness = Freshness()\n",
        "alarm device|nothing was seen",
    ),
    # operations.md: 'Another port is fine, another sensor during a run is refused'; wear is counted on the
    # other's gel.
    Bug(
        "another sensor is accepted during a run",
        "edge/acquisition.py",
        "        if known is not None and device.identity.serial != known.serial:\n",
        "        if known is not None and device.identity.product != known.product:\n",
        "another sensor|alarm device",
    ),
    # contact.md: 'A press lasts until the gel has been seen free, also over an unplugged sensor: not scored
    # or counted again'.
    Bug(
        "a press ends at an interruption",
        "edge/core/contact/table.py",
        "_row(State.CONTACT, CLEAR=State.RELEASE, INVERSE=State.DOUBT,",
        "_row(State.CONTACT, CLEAR=State.RELEASE, INVERSE=State.DOUBT, GAP=State.NO_CONTACT,",
        "was judged|has . rows",
    ),
    # contact.md: settled or not settled, 'both kinds count for the gel's life'; each gives a result.
    Bug(
        "a press without a still frame is not recorded",
        "edge/gateway/inspection_session.py",
        "                    presses.append(self._judge(Press().reject(Rejection(Reason.NOT_SETTLED, text)), None))\n",
        '                    log.warning("%s", text)\n',
        "is lost",
    ),
    # contact.md: rest is against the frame settle_s before; after an interruption the exposure needs 0.3 s,
    # no frame before it is scored.
    Bug(
        "the rest is measured over an interruption",
        "edge/core/contact/rules.py",
        "        still_frames=0,\n"
        "        window=Window(),\n"
        "        is_wanted=track.is_wanted and not lost,\n",
        "        still_frames=0,\n        is_wanted=track.is_wanted and not lost,\n",
        "after an interruption",
    ),
    # contact.md, Triggers: 'the first frame at rest from there on is scored'.
    Bug(
        "a frame from before the trigger is scored",
        "edge/core/contact/settled_frame.py",
        "        frames = [frame for frame in self._all if frame.timestamp_ns >= since_ns] or [self.frames[-1]]\n",
        "        frames = list(self._all)\n",
        "before the trigger",
    ),
    # operations.md: 'A selection that the database cannot record is not made'; it was answered as an error.
    Bug(
        "a part change that was refused is made later",
        "edge/gateway/part_selection.py",
        "        except StoreError:\n            self._wanted, self._why = before, None\n            raise\n",
        "        except StoreError:\n            self._why = None\n            raise\n",
        "judged as|retains the part",
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
        "a pass is shown|lamp",
    ),
    # operations.md: 'A pass is shown when it is in the database, a fail at once'.
    Bug(
        "a pass is shown before it is recorded",
        "edge/features/outputs/stage.py",
        "            self._awaited_ns = press.judged_ns\n",
        "            self._verdict = press.word\n            self._awaited_ns = press.judged_ns\n",
        "a pass was shown|a pass is shown",
    ),
    # operations.md, mqtt.md: alarm `outbox_full`, 'unsent messages were dropped'; `dropped` of stats.
    Bug(
        "drops are not counted",
        "edge/store/outbox.py",
        '    _count_drops(connection, "dropped", victims)\n\n\ndef',
        "\n\ndef",
        "dropped",
    ),
    # mqtt.md: 'heatmaps first, passes next, fails last'.
    Bug(
        "the oldest is dropped first",
        "edge/store/outbox.py",
        "ORDER BY worth, row_id LIMIT 64",
        "ORDER BY row_id LIMIT 64",
        "dropped",
    ),
    # mqtt.md: 'The same verb and transaction id within a minute are the same request: it is not done twice'.
    Bug(
        "a repeated request is done again",
        "edge/store/press_store.py",
        "after_ns = now_ns - int(within_s * 1e9)",
        "after_ns = now_ns - int(within_s * 1e6)",
        "was done . times",
    ),
    # architecture.md: 'When the store refuses a press, the loop halts: requests are answered'.
    Bug(
        "requests wait while the station is halted",
        "edge/gateway/station_loop.py",
        "        parts.calls.serve(self)\n        if self._is_reload_wanted:\n",
        "        if not self.is_halted:\n"
        "            parts.calls.serve(self)\n"
        "        if self._is_reload_wanted:\n",
        "has no answer",
    ),
    # mqtt.md: state `stopped: ended on purpose`; the broker publishes the will `lost` over it.
    Bug(
        "the intended end is a loss",
        "plugins/sinks/mqtt.py",
        "        connection = self._connection\n"
        "        if connection is not None:\n"
        "            connection.close()\n"
        "        self._requests.close()\n",
        "        connection = self._connection\n"
        "        if connection is not None:\n"
        '            connection.abandon("closed here")\n'
        "        self._requests.close()\n",
        "ended in order",
    ),
    # operations.md, alarm `device`: a blind sensor halts the inspection until its frames show the gel.
    Bug(
        "frames alone end blindness",
        "edge/gateway/status.py",
        "                self._sensor_fault = None\n            elif",
        "                self._sensor_fault = self._blind = None\n            elif",
        "alarm device|ready",
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
        "if uses == 0]",
        "if uses <= 1]",
        "archive",
    ),
    # mqtt.md: 'Each picture names its press': after a kill with two owed pictures both are drawn of the last.
    Bug(
        "the picture of the last owed press for all",
        "edge/gateway/pictures.py",
        "            self._waiting.append(PressDrawing(press_id, partial(self._draw_again, press_id)))\n",
        "            self._waiting.append(PressDrawing(press_id, lambda: self._draw_again(press_id)))\n",
        "name another press|picture message",
    ),
    # operations.md: 'refused messages are offered again within a minute'.
    Bug(
        "refused rows are not offered again",
        "edge/messaging/sink_worker.py",
        "        if self._offered_ns is None or now_ns - self._offered_ns >= OFFER_REFUSED_S * 1e9:\n",
        "        if self._offered_ns is None:\n",
        "messages still wait|alarm refused",
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
    # operations.md: state `halted` while a fault lasts; the end of one hides the other.
    Bug(
        "one clear ends all faults",
        "edge/gateway/status.py",
        "            if self._faults.pop(alarm, None) is not None:\n                self.say(alarm, None)\n",
        "            if alarm in self._faults:\n"
        "                self._faults.clear()\n"
        "                self.say(alarm, None)\n",
        "ready",
    ),
    # operations.md: 'the database is removed: numbers of presses go on'.
    Bug(
        "numbers are used again after a lost database",
        "edge/store/press_counts.py",
        "        _continue_numbers(connection, known.sequence)\n",
        "",
        "number",
    ),
    # operations.md: 'the count of each gel goes on from gelgate.db.counts'.
    Bug(
        "the second record is not written",
        "edge/gateway/recorder.py",
        "        self._store.keep_count(gel)\n",
        "        pass\n",
        "presses, and|counts",
    ),
    # operations.md, Reference press: one press; the next one is a part's again and has a result.
    Bug(
        "the reference press lasts",
        "edge/features/reference_press.py",
        "        armed, self._armed = self._armed, None\n        return label",
        "        armed = self._armed\n        return label",
        "reference",
    ),
    # operations.md: 'a pass goes out after half a second without a picture of the gel'.
    Bug(
        "a pass stays while nothing is seen",
        "edge/features/outputs/stage.py",
        "UNSEEN_S: Final = 0.5",
        "UNSEEN_S: Final = 5.0",
        "a pass is shown",
    ),
    # config.md, jsonl: one JSON line each; a full disk leaves half of one, and the next is joined to it.
    Bug(
        "half a line stays in the file",
        "plugins/sinks/jsonl.py",
        "                file.truncate(start)  # an incomplete line would damage the next one too\n"
        "                raise\n",
        "                raise\n",
        "line",
    ),
    # operations.md: '`gelgate station acts` keeps each time without sight (`not_seen`)'.
    Bug(
        "time without sight is not kept",
        "edge/features/sensing_watch.py",
        "            self._note_unseen(timestamp_ns)\n            self._seen_ns",
        "            self._seen_ns",
        "nothing was seen",
    ),
)
