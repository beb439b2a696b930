"""`gelgate bundle regions`: places that are ignored, alone judged, or judged more strictly, in a new revision."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx.parser
import pytest
import tiny
import turned_parts as parts
from command_line import Outcome, gelgate, ran
from confirmed_station import Judged
from graph_session import open_graph
from registered_bundle import registered
from station import gel, jpeg

from calibration.fitting.presses.nominal_presses import read_presses
from calibration.fitting.regions.drawing import draw_again, draw_regions, parse_region, read_regions
from calibration.fitting.teach import hold_out
from edge.clock import SystemClock
from edge.core.contact.mask import Touch
from edge.core.detector import Bank
from edge.core.drawn_regions import DrawnRegion, DrawnRegions
from edge.core.errors import FitError
from edge.core.imaging.frames import CameraFrame
from edge.core.press import Press
from edge.core.registration.pose import Pose
from edge.model.bundle import Bundle, Graphs
from edge.model.bundle_writer import bundle_files, facts_of, rewrite_files, write_bundle
from edge.model.inspector import Inspector
from edge.model.manifest import REGION_WEIGHTS
from edge.model.scorer import Scored, Scorer

DENT = "ignore dent 4.5,3.9 8.6,3.9 8.6,8.1 4.5,8.1"
"""Around the film's dent, and the cells of the map that it reaches."""


def draw(inspected: Judged, output: Path, *words: object, bundle: Path | None = None) -> Outcome:
    old = bundle or inspected.old
    return gelgate("bundle", "regions", old, *words, "-o", output, "--no-contact", inspected.free)


def film_press(*, dent: bool, shift_px: int = 0, depth: float = 1.0) -> np.ndarray:
    """A press of the film as a picture, its dent moved."""
    sound, seed = gel(np.random.default_rng(5), depth).astype(np.float64), 5
    dented = gel(np.random.default_rng(seed), depth, dent=dent)
    moved = sound + np.roll(dented - sound, shift_px, axis=0)
    return np.clip(np.rint(moved), 0, 255).astype(np.uint8)


def score(bundle: Path, picture: np.ndarray, folder: Path) -> Scored:
    loaded, file = Bundle.load(bundle), folder / "press.jpg"
    file.write_bytes(jpeg(picture))
    (rgb,) = read_presses([file], loaded.profile, loaded.region).frames
    return Scorer(loaded, 1).score(rgb)


def test_a_dent_in_an_ignored_place_passes_and_one_beside_it_fails(inspected: Judged, tmp_path: Path) -> None:
    """The map is 0 there and elsewhere what it was, bit for bit; the old bundle stays, the new one is sound."""
    old, new = inspected.old, tmp_path / "new"
    before = {file: file.read_bytes() for file in old.rglob("*") if file.is_file()}

    done = draw(inspected, new, "--add", DENT)

    assert done.code == 0, done.err
    assert re.search(r"ignored: 1\d\.\d mm2 of 7\d mm2 contact; 1 ignore", done.out)
    assert "revision 2" in done.out
    here, there = film_press(dent=True), film_press(dent=True, shift_px=66)
    raw, weighed = (score(one, here, tmp_path) for one in (old, new))
    weights = Bundle.load(new).bank[REGION_WEIGHTS]
    np.testing.assert_array_equal(weighed.score_map, raw.score_map * weights)
    assert weighed.anomaly_score == weighed.score_map.max() < raw.anomaly_score
    decide = Bundle.load(new).manifest.decide
    assert [decide(one.anomaly_score).kind for one in (raw, weighed)] == ["fail", "pass"]
    assert decide(score(new, there, tmp_path).anomaly_score).kind == "fail"
    assert score(new, there, tmp_path).anomaly_score == score(old, there, tmp_path).anomaly_score
    assert gelgate("bundle", "verify", new).code == 0
    assert "drawn regions" in gelgate("bundle", "inspect", new).out
    assert before == {file: file.read_bytes() for file in old.rglob("*") if file.is_file()}
    unchanged = [file for file in before if file.name not in ("manifest.json", "head.onnx", "manifest.sig")]
    assert all((new / file.relative_to(old)).read_bytes() == before[file] for file in unchanged)


def test_regions_are_added_listed_and_removed(inspected: Judged, tmp_path: Path) -> None:
    """Each time another revision; without regions every golden frame has the score of the first bundle again."""
    first, second, third = (tmp_path / name for name in ("first", "second", "third"))
    assert draw(inspected, first, "--add", DENT).code == 0
    listed = gelgate("bundle", "regions", first).out
    (tmp_path / "regions.toml").write_text(listed)
    assert draw(inspected, second, "--add", "judge face 1,1 13,1 13,13 1,13", bundle=first).code == 0
    drawn = Bundle.load(first).manifest.regions
    assert drawn is not None
    assert read_regions(tmp_path / "regions.toml") == list(drawn.regions)
    assert draw(inspected, third, "--remove", "dent", "--remove", "face", bundle=second).code == 0
    assert "no region is drawn" in gelgate("bundle", "regions", third).out

    old, new = (json.loads((one / "manifest.json").read_text()) for one in (inspected.old, third))
    assert new["revision"] == old["revision"] + 3
    assert new["golden"] == old["golden"]
    assert new["threshold"] == old["threshold"]


@pytest.mark.parametrize(
    "drawn", [DENT, DENT.replace("ignore dent", "stricter dent 1.05")], ids=["ignore", "stricter"]
)
def test_regions_stay_with_a_bundle_that_is_learnt_again(station: Judged, tmp_path: Path, drawn: str) -> None:
    """The same places on the part; a stricter one promises what fits without the press show, as when it was drawn."""
    assert draw(station, tmp_path / "drawn", station.nominal, "--add", drawn).code == 0
    station.say({0: "good", 1: "good"})

    words = tmp_path / "drawn", station.nominal, "-o", station.new, "-c", station.config
    done = gelgate("bundle", "learn", *words, "--no-contact", station.free)

    assert done.code == 0, done.err
    old, new = Bundle.load(tmp_path / "drawn"), Bundle.load(tmp_path / "new")
    assert new.manifest.regions.regions == old.manifest.regions.regions  # type: ignore[union-attr]
    np.testing.assert_array_equal(new.bank[REGION_WEIGHTS], old.bank[REGION_WEIGHTS])
    assert new.manifest.revision == 3
    assert ("the promise with the drawn regions" in new.manifest.threshold.method) == ("stricter" in drawn)
    assert gelgate("bundle", "verify", tmp_path / "new").code == 0


def test_regions_that_would_lie_elsewhere_are_refused_with_the_way_on() -> None:
    """The new fit brings presses to a pose, and the old one had none."""
    new = registered()
    old = replace(new.bundle(), registration=None)
    regions = DrawnRegions((DrawnRegion("logo", "ignore", ((1, 1), (2, 1), (2, 2))),))
    old = replace(old, manifest=old.manifest.model_copy(update={"regions": regions}))
    with pytest.raises(FitError, match=r"to another pose.*--remove 'logo' -o PLAIN`, and use PLAIN instead"):
        draw_again(old, new, None, None, "2026-01-01")  # type: ignore[arg-type]


def test_where_an_ignored_place_counts_in_the_surroundings_it_is_said(
    inspected: Judged, tmp_path: Path
) -> None:
    """Only of a bundle whose limit has surroundings, and where something is ignored."""
    old = Bundle.load(inspected.old)
    window = Bank({**old.bank, "limit_window_up_rows": np.ones((1, 1), np.float32)})
    files = rewrite_files(old, facts_of(old.manifest), old.golden, bank=window)[1]
    bundle = write_bundle(tmp_path / "surroundings", files)

    plain = draw(inspected, tmp_path / "plain", "--add", DENT)
    around = draw(inspected, tmp_path / "around", "--add", DENT, bundle=bundle)

    said = "a change in an ignored place hides faint damage within 2.25 mm of it"
    assert [said in one.out for one in (plain, around)] == [False, True]


def test_a_stricter_region_finds_a_fainter_dent_and_promises_anew(inspected: Judged, tmp_path: Path) -> None:
    """By the nominal presses, which banks without them score; the threshold stays."""
    new, nominal = tmp_path / "new", inspected.nominal
    strict = DENT.replace("ignore dent", "stricter seam 1.05")

    done = draw(inspected, new, nominal, "--add", strict)

    assert done.code == 0, done.err
    old, made = Bundle.load(inspected.old).manifest, Bundle.load(new).manifest
    assert made.threshold.value == old.threshold.value
    assert made.threshold.by_press is not None
    assert "the promise with the drawn regions" in made.threshold.method
    assert made.threshold.nominal_scores != old.threshold.nominal_scores
    faint = film_press(dent=False)
    dented = film_press(dent=True)
    mixed = np.rint(faint + 0.86 * (dented.astype(np.float64) - faint)).astype(np.uint8)
    kinds = [made.decide(score(one, mixed, tmp_path).anomaly_score).kind for one in (inspected.old, new)]
    assert kinds == ["pass", "fail"]
    assert gelgate("bundle", "verify", new).code == 0


def test_a_factor_failing_all_is_refused_with_one_failing_none(inspected: Judged, tmp_path: Path) -> None:
    strict = DENT.replace("ignore dent", "stricter seam {}")
    refused = draw(inspected, tmp_path / "new", inspected.nominal, "--add", strict.format(10)).sentence()
    factor = refused.split("every sound press would fail")[1].split("a factor of ")[1].split()[0]
    assert draw(inspected, tmp_path / "new", inspected.nominal, "--add", strict.format(factor)).code == 0


def test_a_limit_of_an_earlier_version_gets_no_promise_of_another_limit(inspected: Judged) -> None:
    """Fits of today divide a map by its surroundings; those before 99cf57fa subtracted them."""
    old = Bundle.load(inspected.old)
    limits = {name: array for name, array in old.bank.items() if name != "limit_usual"}
    old = replace(old, bank=limits | {"limit_grid": np.ones((1, 1), np.float32)})
    with pytest.raises(FitError, match=r"has a limit of an earlier version.*fit it again"):
        hold_out(old, range(99), None, "2026-01-01")  # type: ignore[arg-type]


OVER_ALL = "ignore all 0,0 14.2,0 14.2,14.2 0,14.2"
TRIANGLE = "2,2 4,2 4,4"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["--add", OVER_ALL],
            "leave 0.0 mm2 of the .* mm2 that nominal presses touch, expected at least 1 mm2",
        ),
        (
            ["--add", "ignore most 0,0 14.2,0 14.2,11 0,11"],
            r"ignore 67.\d mm2 of the 7\d.\d mm2 .*less than 90 %.*make what is ignored smaller",
        ),
        (["--add", "judge corner 0,0 0.5,0 0.5,0.5"], "leave 0.0 mm2 .*nothing would be judged"),
        (
            ["--add", "ignore far 20,2 24,2 24,4"],
            r"a point at \(20, 2\) mm, outside the field of 14.2 x 14.2 mm",
        ),
        (["--add", "ignore line 2,2 4,4"], "region 'line' has 2 points, expected 3 to 256"),
        (["--add", f"stricter seam {TRIANGLE}"], "the factor 1, expected more than 1 and at most 10"),
        (
            ["--add", f"stricter seam 2 {TRIANGLE}"],
            "keeps no maps of its nominal presses .* give the presses",
        ),
        (["--add", f"strict seam 2 {TRIANGLE}"], "expected ignore, judge or stricter|expected a point"),
        (["--add", "ignore logo"], "'ignore logo' has no place; write"),
        (["--add", "ignore logo mask.png"], "found 'mask.png', expected a point as x,y in mm"),
        (["--file", "not.toml"], "not.toml is no TOML file"),
        (["--file", "other.toml"], r"other.toml has \['areas'\], expected tables \[\[regions\]\] alone"),
        (["--file", "key.toml"], "a region has name, kind, points_mm, factor, found 'colour'"),
        (["--file", "lack.toml"], "a region lacks points_mm"),
        (["--file", "points.toml"], r"points_mm are \[x, y\] in mm"),
        (["--remove", "dent"], "the bundle has no region 'dent'; it has none"),
    ],
)
def test_a_wrong_region_is_one_sentence_and_nothing_is_written(
    inspected: Judged, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], sentence: str
) -> None:
    monkeypatch.chdir(tmp_path)
    texts = {
        "not": "[[regions",
        "other": "[[areas]]\nname = 'x'",
        "key": "[[regions]]\ncolour = 'red'",
        "lack": "[[regions]]\nname = 'x'\nkind = 'ignore'",
        "points": "[[regions]]\nname = 'x'\nkind = 'ignore'\npoints_mm = [1, 2, 3]",
    }
    for name, text in texts.items():
        Path(f"{name}.toml").write_text(text)

    done = draw(inspected, tmp_path / "new", *words)

    assert done.code == 3, done.out
    assert re.search(sentence, done.sentence())
    assert not (tmp_path / "new").exists()


def test_the_bundle_itself_is_never_replaced(inspected: Judged) -> None:
    done = draw(inspected, inspected.old, "--add", DENT, "--overwrite")
    assert done.code == 3
    assert "beside the bundle, never in its place; give another place with --output" in done.sentence()


SINGLE = """
    < ir_version: 8, opset_import: ["" : 17] >
    other (uint8[n, 32, 32, 3] frames) => (float[n, 32, 32] score_map, float[n] score)
    <int64[1] last = {3}>
    {
        pixels = Cast <to = 1> (frames)
        score_map = ReduceMax <axes = [3], keepdims = 0> (pixels)
        score = ReduceMax <axes = [1, 2], keepdims = 0> (score_map)
    }
"""


def test_a_bundle_that_cannot_be_weighed_says_why(tmp_path: Path) -> None:
    """A graph of another tool, a score that is no maximum of the map, a threshold of 0, no golden frames, and a free
    gel that is not known."""
    logo = [DrawnRegion("logo", "ignore", ((0.1, 0.1), (0.5, 0.1), (0.5, 0.5)))]
    single = bundle_files(
        tiny.tiny_facts(), Graphs(detector=onnx.parser.parse_model(SINGLE).SerializeToString())
    )
    plain = tiny.tiny_files()
    zero = tiny.tiny_files(threshold=0.0)
    for files, sentence in (
        (single, "it is a single graph of another tool"),
        (plain, "it has no golden frames"),
        (zero, "its threshold is 0"),
    ):
        path = write_bundle(tmp_path / "bundle", files[1], overwrite=True)
        with pytest.raises(FitError, match=f"cannot have regions: {sentence}"):
            draw_regions(path, logo, None, 1)


def test_a_free_gel_that_is_not_known_and_a_mean_score_are_refused(inspected: Judged, tmp_path: Path) -> None:
    logo = [parse_region(DENT)]

    def lower(content: dict[str, Any]) -> None:
        content["golden"][0]["score"] *= 0.9

    for change, sentence in (
        (lambda content: content.update(free_view=None), "does not know the free gel"),
        (lower, "not the highest value"),
    ):
        changed = tmp_path / "changed"
        shutil.copytree(inspected.old, changed, dirs_exist_ok=True)
        content = json.loads((changed / "manifest.json").read_text())
        change(content)
        (changed / "manifest.json").write_text(json.dumps(content))
        with pytest.raises(FitError, match=sentence):
            draw_regions(changed, logo, None, 1)


def test_a_manifest_whose_regions_are_not_in_its_bank_is_refused(inspected: Judged, tmp_path: Path) -> None:
    """Nothing is shown as judged that is not, and nothing ignored that is not shown."""
    new = tmp_path / "new"
    assert draw(inspected, new, "--add", DENT).code == 0
    content = json.loads((new / "manifest.json").read_text())
    content["regions"] = None
    (new / "manifest.json").write_text(json.dumps(content))
    assert gelgate("bundle", "verify", new).code == 5


def inspect(bundle: Bundle, picture: np.ndarray) -> Press:
    frame = CameraFrame(jpeg(picture), 0, 0, True)
    return Inspector(Scorer(bundle, 1), SystemClock()).inspect(frame, Touch(0.3))


def test_a_press_that_touches_ignored_places_alone_is_rejected(inspected: Judged, tmp_path: Path) -> None:
    """It says so; the same press passes where the place is judged, and one that touches both passes."""
    new = tmp_path / "new"
    assert draw(inspected, new, "--add", "ignore left 0,0 8.5,0 8.5,14.2 0,14.2").code == 0
    bundle = Bundle.load(new)
    limit = bundle.manifest.threshold.model_copy(
        update={"value": 99.0}
    )  # that a part is missing is another rule
    lenient = replace(
        bundle, manifest=bundle.manifest.model_copy(update={"threshold": limit, "contact": None})
    )
    whole, free = film_press(dent=False), gel(np.random.default_rng(5), 0.0)
    left = np.where(np.arange(320)[None, :, None] < 160, whole, free)

    assert inspect(lenient, whole).word == "pass"
    pressed = inspect(lenient, left)
    assert pressed.word == "rejected"
    assert (pressed.reason or "").startswith("all_ignored: ")
    assert pressed.score_map is None
    judging = replace(
        lenient, bank={**bundle.bank, REGION_WEIGHTS: np.ones_like(bundle.bank[REGION_WEIGHTS])}
    )
    assert inspect(judging, left).word == "pass"


def test_missing_relief_counts_in_ignored_places(other_package: None) -> None:
    """A head that checks relief shows its map through a region of weight 0."""
    from calibration.fitting.limits.appended import append
    from edge.core.detector import Bank

    scores = np.zeros((1, 8, 8), np.float32)
    head = onnx.parser.parse_model("""
        < ir_version: 8, opset_import: ["" : 18] >
        head (float[n, 8, 8] tap, float[n, 8, 8] relief_map) => (float[n, 8, 8] score_map, float[n] score)
        <int64[2] axes = {1, 2}>
        { score_map = Max (tap, relief_map)  score = ReduceMax <keepdims = 0> (score_map, axes) }
    """).SerializeToString()
    weights = np.ones((8, 8), np.float32)
    weights[:4] = 0
    known = Bank({"relief_free": np.zeros(1, np.float32)})
    extended, _ = append(head, known, {REGION_WEIGHTS: weights})

    relief, damage = scores.copy(), scores.copy()
    relief[0, 1, 1], damage[0, 2, 2], damage[0, 6, 6] = 3.0, 9.0, 2.0
    given = {"tap": damage, "relief_map": relief, REGION_WEIGHTS: weights}
    score_map, peak = open_graph(extended).run(["score_map", "score"], given)
    truth = np.maximum(damage.astype(np.float64) * weights, relief)
    np.testing.assert_array_equal(score_map, truth)
    assert peak == [3.0]


def test_a_part_that_looks_the_same_in_several_turns_is_refused(tmp_path: Path) -> None:
    """A region would lie at one of them, and nobody knows at which; but the turn of a part that is held is known."""
    path = write_bundle(tmp_path / "registered", registered().files)

    def draw(**facts: object) -> object:
        content = json.loads((path / "manifest.json").read_text())
        content["registration"] |= facts
        (path / "manifest.json").write_text(json.dumps(content))
        return draw_regions(path, [DrawnRegion("logo", "ignore", ((1, 1), (2, 1), (2, 2)))], None, 1)

    def say(name: str) -> str:
        drawn = ("--add", "ignore logo 1,1 2,1 2,2", "-o", tmp_path / name)
        return ran("bundle", "regions", path, *drawn)

    assert "half a pitch off" not in say("unique")
    with pytest.raises(FitError, match="its part looks the same 4 times in a full turn"):
        draw(symmetry=4)
    assert draw(is_held=True)
    assert "a press half a pitch off has its regions a pitch further on" in say("regular")


def in_bank(bundle: Bundle, pose: Pose, points: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Bring points of the part, pixels from its middle, to mm of the bank's pose, by a press in a known pose."""
    assert bundle.registration is not None
    found = bundle.registration.open().register(parts.press(parts.BLOCK, pose, seed=3)).pose
    middle = (parts.SIDE - 1) / 2
    in_press = np.array(points) @ pose.matrix((1, 1))[:, :2].T + [pose.x_px, pose.y_px] + middle
    back = found.inverse().matrix((parts.SIDE, parts.SIDE))
    in_pose = in_press @ back[:, :2].T + back[:, 2]
    return tuple((float(x), float(y)) for x, y in (in_pose + 0.5) * bundle.profile.mm_per_pixel)


def test_regions_follow_a_part_that_lies_anywhere(tmp_path: Path) -> None:
    """A bump of the part that is ignored is ignored in every pose, and one beside it is found in every pose."""
    path = write_bundle(tmp_path / "registered", registered().files)
    old = Bundle.load(path)
    logo, burr = (4.0, -32.0, 3.5, 4.0), (-4.0, 34.0, 3.5, 4.0)
    around = [(logo[0] + dx, logo[1] + dy) for dx, dy in ((-18, -18), (18, -18), (18, 18), (-18, 18))]
    region = DrawnRegion("logo", "ignore", in_bank(old, Pose(3.0, 2.0, 0.4), around))
    new = draw_regions(path, [region], None, 1).bundle()
    before, after = Scorer(old, 1), Scorer(new, 1)
    for pose in (Pose(8.0, 1.0, 1.25), Pose(-6.0, 4.0, -2.0), Pose(0.0, -5.0, 3.0)):
        ignored = parts.press((*parts.BLOCK, logo), pose, seed=9)
        damaged = parts.press((*parts.BLOCK, burr), pose, seed=9)
        words = [
            new.manifest.decide(one.score(rgb).anomaly_score).kind
            for one in (before, after)
            for rgb in (ignored, damaged)
        ]
        assert words == ["fail", "fail", "pass", "fail"], pose
