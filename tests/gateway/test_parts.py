"""Several parts at one station: selected between two presses, changed while it runs, the last good bundles kept."""

import math
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import pytest
from station import station_config, two_parts, variant
from stepped_station import SteppedStation

from edge.clock import SystemClock
from edge.config import load_config
from edge.core.errors import BundleCorrupt, BundleMismatch, ConfigError, StoreError
from edge.core.part_position import PartPosition
from edge.gateway.opening import BundleOpener, Opened
from edge.model.archive import open_archive
from edge.model.session import TrunkSessions
from edge.model.signing import new_key
from edge.store.bundles_in_use import read_selected
from edge.store.press_store import Store

PZ0, PZ1 = PartPosition("PZ0", "pos1"), PartPosition("PZ1", "pos1")


@pytest.fixture
def folder(tmp_path: Path, bundle: Path) -> Path:
    """Two bundles that differ in part and threshold: every press passes the second."""
    two_parts(tmp_path / "bundles", bundle)
    return tmp_path / "bundles"


@pytest.fixture
def config(tmp_path: Path, recording: Path, folder: Path) -> Path:
    return station_config(tmp_path / "station", recording, f'bundle_folder = "{folder}"')


@pytest.fixture
def station(config: Path) -> Iterator[SteppedStation]:
    with SteppedStation(config) as stepped:
        yield stepped


def test_all_bundles_share_one_trunk(station: SteppedStation) -> None:
    """The second bundle is opened without another copy of the backbone in memory."""
    first, second = (one.inspector.scorer for one in station.parts.selection.bundles.bundles.values())

    assert first._trunk is second._trunk
    assert second.bundle.graphs.trunk is None


def test_the_selected_part_is_inspected_from_the_next_press_on(station: SteppedStation) -> None:
    """The dented press fails as PZ0; as PZ1, with its own threshold, it passes, and its result says so."""
    station.play_until(lambda: len(station.reports) == 1)
    station.ask("select_part", part="PZ1")
    station.play()

    results = station.results
    assert [one.part for one in results] == ["PZ0", "PZ1", "PZ1"]
    assert station.verdicts == ["pass"] * 3
    info = station.said("info")
    assert (info["part"], info["bundle_id"]) == ("PZ1", results[-1].bundle_id)
    assert info["parts"] == ["PZ0/pos1", "PZ1/pos1"]
    assert results[0].bundle_id != results[-1].bundle_id


def test_a_selected_part_is_warm_before_its_first_press(station: SteppedStation) -> None:
    """Its memory is allocated and its time is known, so that its first press too is scored ahead."""
    station.play_until(lambda: len(station.reports) == 1)
    station.play_until(lambda: not station.loop.is_pressed)
    assert station.parts.selection.bundles[PZ1].inspector.took_s == math.inf
    station.ask("select_part", part="PZ1")
    assert station.parts.selection.bundles[PZ1].inspector.took_s < math.inf


def test_a_part_that_is_left_keeps_no_frames(station: SteppedStation) -> None:
    """A press that was scored ahead ends without a verdict: its pictures do not wait for the part's return."""
    inspector = station.parts.selection.inspector
    station.play_until(lambda: len(station.reports) == 1)
    station.play_until(lambda: bool(inspector._ahead))
    station.ask("replace_gel")
    station.ask("select_part", part="PZ1")

    assert station.parts.selection.inspector is not inspector
    assert not inspector._ahead


def test_a_part_selected_during_a_press_waits_for_its_end(station: SteppedStation) -> None:
    """The press is judged by the bundle with which it began."""
    station.play_until(lambda: station.loop.session is not None and station.loop.session.has_contact)
    station.ask("select_part", name="PZ1")
    assert station.parts.selection.is_waiting
    station.play_until(lambda: len(station.reports) == 1)
    assert station.reports[0].result.part == "PZ0"
    station.play_until(lambda: not station.loop.session.has_contact)
    assert not station.parts.selection.is_waiting
    station.play()

    assert [result.part for result in station.results] == ["PZ0", "PZ1", "PZ1"]


def test_the_learnt_free_gel_stays_over_a_change_of_part(station: SteppedStation) -> None:
    """The station is ready for the next press at once."""
    station.play_until(lambda: len(station.reports) == 1)
    station.play_until(lambda: not station.loop.session.has_contact)
    reference = station.loop.session._detector.tracker.reference
    station.ask("select_part", part="PZ1")

    assert station.loop.session._detector.tracker.reference is reference
    assert station.said("state")["state"] == "ready"


def test_a_station_starts_with_the_part_that_was_selected_last(config: Path) -> None:
    """Also after a power cut: the part on the line did not change with it."""
    with SteppedStation(config) as station:
        station.ask("select_part", part="PZ1")
    with SteppedStation(config) as station:
        assert station.parts.selection.part == PZ1


def test_a_new_station_starts_with_the_configured_part(tmp_path: Path, recording: Path, folder: Path) -> None:
    """By any of its names."""
    bundles = f'[{{ path = "{folder / "a"}" }}, {{ path = "{folder / "b"}", names = ["4711"] }}]'
    config = station_config(tmp_path / "station", recording, f'part = "4711"\nbundles = {bundles}')
    with SteppedStation(config) as station:
        assert station.parts.selection.part == PZ1
        station.ask("select_part", name="PZ0")
        station.ask("select_part", name="4711")
        assert station.parts.selection.part == PZ1


@pytest.mark.parametrize(
    ("bundles", "said"),
    [
        ('bundle_folder = "{0}"', []),
        ('bundle_folder = "{0}"\npart = "PZ1"', []),
        (
            'bundle_folder = "{0}"\npart = "PZ0"',
            ["PZ1/pos1 is inspected: selected last; inspection.part, PZ0/pos1, is a new station's"],
        ),
        (
            'bundle = "{0}/a"',
            ["PZ0/pos1 is inspected: PZ1/pos1, selected last, has no bundle here any more"],
        ),
    ],
)
def test_a_start_says_where_the_configuration_or_the_selection_does_not_hold(
    bundles: str,
    said: list[str],
    tmp_path: Path,
    recording: Path,
    folder: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """PZ1 was selected last."""
    config = station_config(tmp_path / "station", recording, bundles.format(folder))
    with Store(load_config(config).store.path) as store:
        store.use_bundle(PZ1, None, "digest", 0)
    with SteppedStation(config):
        assert [text for text in caplog.messages if "is inspected: " in text] == said


def test_an_unknown_name_is_refused_and_nothing_changes(station: SteppedStation) -> None:
    words = r"no part of this station is named 'PZ2'; known: PZ0/pos1, PZ1/pos1"
    with pytest.raises(ValueError, match=words):
        station.ask("select_part", name="PZ2")
    assert station.parts.selection.part == PZ0


def test_a_part_with_several_positions_needs_one(tmp_path: Path, recording: Path, bundle: Path) -> None:
    for name, position in (("a", "left"), ("b", "right")):
        variant(bundle, tmp_path / "bundles" / name, position=position)
    config = station_config(tmp_path / "station", recording, f'bundle_folder = "{tmp_path / "bundles"}"')
    with SteppedStation(config) as station:
        with pytest.raises(ValueError, match="several positions here \\(PZ0/left, PZ0/right\\)"):
            station.ask("select_part", part="PZ0")
        station.ask("select_part", part="PZ0", position="right")
        assert station.parts.selection.part == PartPosition("PZ0", "right")


@pytest.mark.parametrize(
    ("part", "controls", "words"),
    [
        ("PZ0", {}, r"is for PZ0/pos1, as .*a is"),  # which of them inspects would depend on their order
        # A switch between presses leaves the camera as it is.
        ("PZ3", {"exposure": 7}, r"needs the sensor's controls \{'exposure': 7\}"),
    ],
)
def test_a_bundle_that_cannot_stand_beside_the_others_is_refused(
    config: Path, folder: Path, bundle: Path, part: str, controls: dict[str, int], words: str
) -> None:
    variant(bundle, folder / "c", part=part, profile={"controls": controls})
    with pytest.raises((BundleMismatch, ConfigError), match=words):
        SteppedStation(config)


def test_a_new_bundle_takes_over_at_a_reload(station: SteppedStation, folder: Path, bundle: Path) -> None:
    """The one in use is exchanged; the other one, which has not changed, is not opened again."""
    selection = station.parts.selection
    old, other = selection.inspector, selection.bundles[PZ1].inspector
    variant(bundle, folder / "a", revision=2)
    station.reload()

    assert selection.inspector is not old
    assert selection.inspector.bundle.manifest.revision == 2
    assert selection.bundles[PZ1].inspector is other
    assert station.parts.store.newest_revision(PZ0) == 2


def spoil(path: Path) -> None:
    """Change the last byte of the file, or of one in the folder; in the place of a manifest put a folder."""
    file = next(path.iterdir()) if path.is_dir() else path
    content = file.read_bytes()
    file.unlink()
    if file.name == "manifest.json":
        file.mkdir()
    else:
        file.write_bytes(content[:-1] + b"!")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("head.onnx", "head.onnx has SHA-256"),
        ("trunk.onnx", "trunk.onnx has SHA-256"),
        ("bank", ".npy has SHA-256"),
        ("manifest.json", "manifest.json cannot be read (Is a directory)"),
    ],
)
def test_the_last_good_bundle_stays_when_the_new_one_fails(
    station: SteppedStation, folder: Path, bundle: Path, name: str, words: str
) -> None:
    """The next start would refuse it, so the reload does: alarm `bundle`, which ends with a good one. The other new
    bundle of the same reload is used."""
    selection = station.parts.selection
    old = selection.inspector
    spoil(folder / "a" / name)
    variant(bundle, folder / "b", part="PZ1", revision=7)
    station.reload()

    assert selection.inspector is old
    assert selection.bundles[PZ1].bundle.manifest.revision == 7
    assert words in str(station.alarm("bundle"))
    variant(bundle, folder / "a", revision=5)
    station.reload()
    assert selection.inspector.bundle.manifest.revision == 5
    assert station.alarm("bundle") is None


def test_info_names_parts_of_a_reload_that_cannot_be_recorded(
    station: SteppedStation, folder: Path, bundle: Path
) -> None:
    """They may be selected already, and no later turn sees that they are new."""
    station.play(3)
    variant(bundle, folder / "c", part="PZ2")
    with station.refusing("acts"):
        station.reload()
        assert station.loop.is_halted
    station.turn(2)

    assert station.said("info")["parts"] == ["PZ0/pos1", "PZ1/pos1", "PZ2/pos1"]


def test_an_older_bundle_is_refused_unless_allowed(config: Path, folder: Path, bundle: Path) -> None:
    """At a reload the newer one stays, at a start nothing runs; allowed once, it is the newest."""
    variant(bundle, folder / "a", revision=3)
    with SteppedStation(config) as station:
        station.loop.step(None)
        variant(bundle, folder / "a", revision=2)
        station.reload()
        assert station.parts.selection.inspector.bundle.manifest.revision == 3
        assert "has revision 2, and revision 3 was in use" in str(station.alarm("bundle"))
    with pytest.raises(BundleMismatch, match="has revision 2, and revision 3 was in use here"):
        SteppedStation(config)

    variant(bundle, folder / "a")
    with pytest.raises(BundleMismatch, match="has no revision, and revision 3 was in use here"):
        SteppedStation(config)

    variant(bundle, folder / "a", revision=2)
    config.write_text(config.read_text().replace("bundle_folder", 'older = "allowed"\nbundle_folder'))
    with SteppedStation(config) as station:
        station.loop.step(None)
    config.write_text(config.read_text().replace('older = "allowed"', 'older = "refused"'))
    with SteppedStation(config) as station:
        assert station.parts.selection.inspector.bundle.manifest.revision == 2


def test_the_selected_part_cannot_be_removed_by_a_reload(station: SteppedStation, folder: Path) -> None:
    """It goes on being inspected, and the alarm says why nothing was taken."""
    shutil.rmtree(folder / "a")
    station.reload()
    assert station.parts.selection.part == PZ0
    assert "there is no bundle for the selected PZ0/pos1 any more" in str(station.alarm("bundle"))

    station.ask("select_part", part="PZ1")
    station.reload()
    assert list(station.parts.selection.bundles.bundles) == [PZ1]
    assert station.alarm("bundle") is None


def test_a_reload_reads_the_configuration_again(tmp_path: Path, config: Path, folder: Path) -> None:
    """A configuration with a fault leaves everything as it is."""
    with SteppedStation(config) as station:
        good = config.read_text()
        config.write_text(good.replace(str(folder), str(tmp_path / "nowhere")))
        station.reload()
        assert "nowhere cannot be read" in str(station.alarm("bundle"))
        config.write_text(good + "\n[unheard]\n")
        station.reload()
        assert "'unheard' is not known" in str(station.alarm("bundle"))
        assert station.parts.selection.part == PZ0


def test_a_reload_names_what_waits_for_a_restart(config: Path) -> None:
    """Who has turned a second press off, or a request, would take `done` for it."""
    with SteppedStation(config) as station:
        station.turn()
        station.reload()
        good = config.read_text()
        again = good.replace("[inspection]", '[inspection]\npress_again = "unsure"', 1)
        config.write_text(f"{again}\n[confirm]\nquestions_per_day = 3\n")
        station.reload()
        station.turn(2)
        acts = [(act.outcome, act.sentence) for act in station.parts.store.acts()]

    assert acts == [
        (
            "done",
            "changed in the configuration, and read at the next start alone: confirm, inspection.press_again",
        ),
        ("done", None),
    ]


def test_a_trunk_that_no_bundle_uses_any_more_is_forgotten(config: Path) -> None:
    """A gateway that runs for months keeps the backbones of its bundles and no others."""
    trunks = TrunkSessions()
    opener = BundleOpener(None, 1, SystemClock())
    opener.trunks = trunks
    table = load_config(config).inspection
    bundles = opener.open(table).bundles
    digest = bundles[PZ0].bundle.trunk_sha256
    graph = open_archive(bundles[PZ0].path).read("trunk.onnx", 1 << 20)
    trunks.get("another", graph, "a test")
    assert (digest in trunks, "another" in trunks) == (True, True)
    opener.open(table, bundles)

    assert (digest in trunks, "another" in trunks) == (True, False)


def test_an_unexpected_fault_while_bundles_are_opened_is_an_alarm(
    station: SteppedStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bundles' thread does not end by it: the next reload is served."""
    opened = Opened(station.parts.selection.bundles, {})
    monkeypatch.setattr(
        station.parts.selection, "_open", Mock(side_effect=[RuntimeError("no such thing"), opened])
    )
    station.reload()
    assert "no such thing" in str(station.alarm("bundle"))
    station.reload()
    assert station.alarm("bundle") is None


def test_every_reload_is_in_the_table_of_acts(station: SteppedStation) -> None:
    """With the bundles that are open after it, once the database accepts the row; they are used meanwhile."""
    station.turn()
    with station.refusing("acts"):
        station.reload()
        assert station.loop.is_halted
        assert station.parts.store.acts() == []
    station.turn(3)
    (act,) = station.parts.store.acts()

    assert not station.loop.is_halted
    assert (act.who, act.verb, act.outcome) == ("the gateway", "open_bundles", "done")
    digest = station.bundle_id
    assert (act.after or {})["bundles"]["PZ0/pos1"] == digest


def test_reloads_that_cannot_be_recorded_at_once_are_recorded_in_order(
    station: SteppedStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second reload hides no failure of the first one from the table of acts."""
    opened = Opened(station.parts.selection.bundles, {})
    monkeypatch.setattr(
        station.parts.selection, "_open", Mock(side_effect=[BundleCorrupt("a torn bundle"), opened])
    )
    station.turn()
    with station.refusing("acts"):
        station.reload()
        station.reload()
    station.turn(3)
    acts = [(act.outcome, act.sentence) for act in station.parts.store.acts()]

    assert acts == [("done", None), ("failed", "a torn bundle")]  # newest first


def test_a_selection_that_cannot_be_recorded_is_not_made(config: Path) -> None:
    """Neither now nor later: the request is answered with the error."""
    with SteppedStation(config) as station:
        station.loop.step(None)
        with station.refusing("selected"), pytest.raises(StoreError, match="no room"):
            station.ask("select_part", part="PZ1")
        station.loop.step(None)

        assert station.parts.selection.part == PZ0
    with Store(config.parent / "gelgate.db") as store:
        assert store.read("reading the selected part", read_selected) == PZ0


def test_a_selection_that_fails_leads_to_no_part_that_a_reload_has_removed(
    station: SteppedStation, folder: Path
) -> None:
    """PZ1 waited for the end of a press when it was taken away and PZ0 was selected, which cannot be recorded."""
    selection = station.parts.selection
    station.play_until(lambda: station.loop.is_pressed)
    station.ask("select_part", part="PZ1")
    shutil.rmtree(folder / "b")
    selection.reload()
    selection.worker.step()
    with station.refusing("acts"), pytest.raises(StoreError, match="no room"):
        station.ask("select_part", part="PZ0")
    station.play_presses(1)

    assert (selection.part, selection.selected) == (PZ0, PZ0)


def test_a_bundle_whose_name_is_no_text_is_a_fault(
    folder: Path, station: SteppedStation, bundle: Path
) -> None:
    """As one that was copied from a machine with names in Latin 1: it stands in no message and no row."""
    station.play_presses(1)
    shutil.copytree(bundle, folder / os.fsdecode(b"m\xfcller"))
    station.reload()
    assert station.alarm("bundle") == (
        f"inspection.bundle_folder: the name 'm\\udcfcller' in {folder} is not UTF-8; rename this bundle"
    )
    station.play_presses(2)


def test_a_key_whose_name_is_no_text_can_be_named(tmp_path: Path, recording: Path, bundle: Path) -> None:
    """What refuses it becomes an alarm and an act, and ends no station."""
    pytest.importorskip("cryptography", reason="signatures need the extra `signing`")
    keys = tmp_path / "keys"
    keys.mkdir()
    new_key(keys / "line4")
    table = f'bundle = "{bundle}"\ntrusted_keys = "{keys}"'
    with SteppedStation(station_config(tmp_path / "station", recording, table)) as station:
        station.play_presses(1)
        (keys / os.fsdecode(b"m\xfcller.pub")).write_text("no key")
        station.reload()
        assert rf"{keys}/m\udcfcller.pub" in str(station.alarm("bundle"))
        station.play_presses(2)


def test_a_bundle_whose_copy_goes_on_is_a_fault(folder: Path, config: Path) -> None:
    """Its manifest has not come yet. It is no part that is missing without a word: those in use stay."""
    with SteppedStation(config) as station:
        for name in ("manifest.json", "head.onnx"):
            (folder / "b" / name).rename(folder / f"late-{name}")
        station.reload()
        assert "b: manifest.json is missing" in str(station.alarm("bundle"))
        assert PZ1 in station.parts.selection.bundles
    with pytest.raises(BundleCorrupt, match=r"b: manifest\.json is missing"), SteppedStation(config):
        pass
