"""A bundle carried over to another gel: what stays, what is found again, what is promised, and what is refused."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import turned_parts as parts
from command_line import Outcome, gelgate
from registered_bundle import nominal as registered_presses
from registered_bundle import registered
from station import gel
from tiny_fit import config as tiny_config
from tiny_fit import presses as tiny_presses

from calibration.fitting.carry import CarryConfig, carry_bundle
from calibration.fitting.fit import Fitted, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses, gather_presses
from calibration.fitting.presses.preparation import prepare_as
from calibration.fitting.regions.drawing import draw_regions
from edge.core.arrays import U8
from edge.core.drawn_regions import DrawnRegion
from edge.core.errors import FitError
from edge.core.imaging.known_profiles import profile
from edge.core.imaging.region import Region
from edge.features.gel_proof import read_origin
from edge.model.bundle import Bundle
from edge.model.bundle_writer import write_bundle
from edge.model.manifest import REGION_WEIGHTS
from edge.model.manifest_facts import promise
from edge.model.scorer import Scorer

SENSOR = profile("cropped_lr")
REGION = Region.centre(SENSOR.size)
# Red, green and blue of the old gel, and of the new one in shares of them.
OLD, TINT = (1.0, 1.0, 1.0), (1.004, 0.9965, 1.001)
CONFIG = CarryConfig("2026-02-01", "G2", threads=1)


def test_limits_of_the_old_gel_go_before_new_presses_are_scored(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another gel has other cuts: with the old limits in the scores the new threshold would be too low."""
    bundle = registered().bundle()
    assert bundle.registration is not None
    limits = np.full(bundle.registration.learnt.shape, 4, np.float32)
    cut = replace(bundle, registration=replace(bundle.registration, gel_limits=limits))
    presses = registered_presses(parts.anywhere(parts.BLOCK, 8, 300)[1])
    for check in ("_check_presses", "_check_change"):
        monkeypatch.setattr(f"calibration.fitting.carry.{check}", lambda *_: None)
    plainly, carried = (carry_bundle(one, presses, CONFIG) for one in (bundle, cut))
    assert carried.bundle().registration is not None
    assert carried.bundle().registration.gel_limits is None  # type: ignore[union-attr]
    assert carried.manifest.threshold.value == plainly.manifest.threshold.value


def picture(rng: np.random.Generator, depth: float, tint: Sequence[float], *, dent: bool = False) -> U8:
    """RGB; every gel but the old one has a speck outside of the inspected region."""
    rgb = gel(rng, depth, dent)[..., ::-1].astype(np.float32) * np.array(tint, np.float32)
    if tint != OLD:
        rgb[100:112, 20:32] -= 60
    return np.clip(np.rint(rgb), 0, 255).astype(np.uint8)


@cache
def pressed(
    count: int, seed: int = 3, tint: tuple[float, ...] = TINT, *, dent: bool = False, depth: float = 1.0
) -> NominalPresses:
    """Presses on a gel of this tint, with its free gel."""
    rng = np.random.default_rng(seed)
    free = [picture(rng, 0.0, tint) for _ in range(4)]
    names = {f"s{k:03d}_p0": picture(rng, depth, tint, dent=dent) for k in range(count)}
    return gather_presses(names, SENSOR, REGION, no_contact=free)


@cache
def old_fit() -> Fitted:
    """Fitted on twelve presses on the old gel."""
    changes = {"profile": SENSOR, "region": REGION, "threads": 1, "limit": "plain", "revision": 4}
    return fit_files(pressed(12, 1, OLD), tiny_config(**changes), created="2026-01-01")


@cache
def old() -> Bundle:
    return old_fit().bundle()


@cache
def new() -> Bundle:
    return carry_bundle(old(), pressed(8), CONFIG).bundle()


def test_bank_and_graphs_stay_and_the_rest_is_of_the_new_gel() -> None:
    """Nothing is learnt again but what belongs to the gel; a station takes it in the place of the old one."""
    manifest = new().manifest

    assert (manifest.head, manifest.backbone) == (old().manifest.head, old().manifest.backbone)
    np.testing.assert_array_equal(new().bank["mean"], old().bank["mean"])
    assert manifest.colours != old().manifest.colours
    assert not np.array_equal(new().free_view, old().free_view)  # type: ignore[arg-type]
    assert manifest.revision == 5
    assert read_origin(manifest).gel_id == "G2"
    assert manifest.facts["gel"]["carried_from"] == old().digest


def test_drawn_regions_are_carried_over(tmp_path: Path) -> None:
    """A logo of the part is there on every gel."""
    logo = DrawnRegion("logo", "ignore", ((4.5, 3.9), (8.6, 3.9), (8.6, 8.1), (4.5, 8.1)))
    drawn = draw_regions(old_fit().write(tmp_path / "old"), [logo], None, 1).bundle()
    carried = carry_bundle(drawn, pressed(8), CONFIG).bundle()
    assert carried.manifest.regions == drawn.manifest.regions
    np.testing.assert_array_equal(carried.bank[REGION_WEIGHTS], drawn.bank[REGION_WEIGHTS])
    limit, (dented,) = carried.manifest.threshold.value, pressed(1, 9, dent=True).frames
    assert Scorer(carried, 1).score(dented).anomaly_score < limit


def test_its_golden_frames_are_presses_on_the_new_gel() -> None:
    """A station that scores them again checks what it inspects with."""
    frames = {frame.tobytes() for frame in prepare_as(old(), pressed(8)).frames}

    assert [golden.rgb.tobytes() in frames for golden in new().golden] == [True, True, False]
    assert Scorer(new(), 1).check_golden() <= new().manifest.tolerance.score


def test_sound_presses_on_the_new_gel_pass_and_damaged_ones_fail() -> None:
    """With the old limit nearly all sound presses fail, for the tint alone is above it; with the new one as few as it
    promises."""
    scorer, limit = Scorer(new(), 1), new().manifest.threshold.value
    sound = [scorer.score(frame).anomaly_score for frame in pressed(12, 9).frames]
    damaged = [scorer.score(frame).anomaly_score for frame in pressed(4, 9, dent=True).frames]

    assert sum(score > old().manifest.threshold.value for score in sound) >= 10
    assert sum(score > limit for score in sound) <= 2  # 1 in 9 on average
    assert limit < min(damaged)


def test_it_promises_what_eight_presses_show_and_no_more() -> None:
    """1 in 9 on average; 1 - .1^(1/8) = 25 % for this bundle, 90 % sure. The limit is that of the new scores alone: a
    quarter of their spread above the highest, the rule of a fit with too few presses for its rate."""
    limit = new().manifest.threshold
    scores = [Scorer(old(), 1).score(rgb).anomaly_score for rgb in pressed(8).frames]
    assert limit.nominal_scores == pytest.approx(sorted(scores), rel=1e-5)
    assert limit.value == pytest.approx(1.25 * max(scores) - 0.25 * np.median(scores), rel=2e-3)
    assert limit.alpha_floor == pytest.approx(1 / 9)
    assert limit.by_press is not None
    assert limit.by_press.rate == pytest.approx(1 - 0.1 ** (1 / 8))
    assert promise(limit).startswith("8 presses, counted as 8 pieces: at best 11 % (1 in 9), not 5 %,")


def test_of_one_piece_nothing_is_promised_of_others() -> None:
    one = replace(pressed(8), specimens=("a",) * 8)
    limit = carry_bundle(old(), one, CONFIG).manifest.threshold
    assert (limit.alpha_floor, limit.rate_range, limit.by_piece) == (1, None, None)
    assert "8 presses of 1 piece: at most 26 % of presses of this piece fail" in promise(limit)


def learnt() -> NominalPresses:
    """Eight presses, the third of them a press that the bundle was learnt from."""
    frames, golden = pressed(8).frames.copy(), old().golden[0].rgb
    frames[2] = next(rgb for rgb in pressed(12, 1, OLD).frames if (old().prepare(rgb) == golden).all())
    return replace(pressed(8), frames=frames)


def elsewhere() -> NominalPresses:
    return replace(pressed(8), touches=tuple(replace(touch, x=0.9) for touch in pressed(8).touches))


def turned() -> NominalPresses:
    """By half: the colours run over the gel otherwise."""
    return replace(pressed(8), frames=np.ascontiguousarray(pressed(8).frames[:, ::-1]))


@pytest.mark.parametrize(
    ("presses", "sentence"),
    [
        (lambda: pressed(3), "found 3 presses on the new gel, expected 4 to 8"),
        (lambda: pressed(9), "found 9 presses on the new gel, expected 4 to 8"),
        (
            lambda: replace(pressed(8), no_contact=None, free_view=None, faults=("the picture is foreign",)),
            "the free new gel is not known; give a picture of it with --no-contact.*; the picture is foreign",
        ),
        (lambda: pressed(8, 5, OLD), "from that of the bundle: it is the old gel"),
        (learnt, "press s002_p0 was learnt for this bundle, so it is of the old gel"),
        (
            lambda: pressed(8, dent=True, tint=(1.3, 0.7, 1.0)),
            r"times as high as the learnt ones in the median, expected 0\.40 to 2\.5 times",
        ),
        (elsewhere, "presses lie where no learnt press does: s000_p0, s001_p0"),
        (turned, "the colours over the gel run otherwise than in the learnt presses"),
    ],
)
def test_unfit_presses_are_refused(presses: Callable[[], NominalPresses], sentence: str) -> None:
    """Too few or too many, of the old gel, of another part, place or kind of sensor."""
    with pytest.raises(FitError, match=sentence):
        carry_bundle(old(), presses(), CONFIG)


def test_a_bundle_with_a_threshold_given_by_hand_is_refused() -> None:
    """There are no scores to compare with."""
    given = old().manifest.threshold.model_copy(update={"nominal_scores": (), "method": "given by hand"})
    bundle = replace(old(), manifest=old().manifest.model_copy(update={"threshold": given}))
    with pytest.raises(FitError, match=r"no scores of presses, so its threshold \(given by hand\) cannot be"):
        carry_bundle(bundle, pressed(8), CONFIG)


def test_it_says_of_its_presses_what_a_fit_says() -> None:
    """Of a damaged one among them, which sets the limit, of a copy, of their sources and their number. What the old
    presses warned of is said of the old gel; what no gel proves stays first."""
    proven = old().manifest.provenance.model_copy(update={"warnings": ("not proven: a", "grey presses")})
    bundle = replace(old(), manifest=old().manifest.model_copy(update={"provenance": proven}))
    frames = pressed(8).frames.copy()
    frames[3], frames[6] = pressed(1, 9, dent=True).frames[0], frames[5]
    presses = replace(pressed(8), frames=frames, faults=("a picture is foreign",))
    *known, copy, rate, apart = carry_bundle(bundle, presses, CONFIG).manifest.provenance.warnings
    assert known == ["not proven: a", "of the old gel: grey presses", "a picture is foreign"]
    assert "('s006_p0') are exact copies of another" in copy
    assert "1/9 at best" in rate
    assert "press 's003_p0' stands apart from the others" in apart
    again = replace(presses, frames=np.repeat(frames[:1], 8, axis=0))
    with pytest.raises(FitError, match="all 8 presses are one picture"):
        carry_bundle(bundle, again, CONFIG)


def test_two_damaged_presses_do_not_hide_each_other() -> None:
    """Each sets a limit by which the other is usual; beside the presses of the fit neither is."""
    frames = pressed(8).frames.copy()
    frames[3], frames[6] = pressed(2, 9, dent=True).frames
    presses = replace(pressed(8), frames=frames)
    warnings = carry_bundle(old(), presses, CONFIG).manifest.provenance.warnings

    assert sorted(words[:15] for words in warnings if "stands apart" in words) == [
        "press 's003_p0'",
        "press 's006_p0'",
    ]


def test_a_limit_by_which_a_black_frame_passes_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """As at a fit: unless the gateway refuses it for its colours, as it does here."""
    high = new().manifest.threshold.model_copy(update={"value": 1e9})
    monkeypatch.setattr("calibration.fitting.carry._threshold", lambda *_: high)
    carry_bundle(old(), pressed(8), CONFIG)
    monkeypatch.setattr("calibration.fitting.carry.refuses", lambda *_: False)
    with pytest.raises(FitError, match=r"a black frame scores .* and would pass"):
        carry_bundle(old(), pressed(8), CONFIG)


def test_a_fit_may_name_its_gel() -> None:
    """A station then knows on which gel the bundle is proven; by default it does not."""
    named = fit_files(tiny_presses(6), tiny_config(gel_id="G7"), created="2026-01-01").manifest

    assert read_origin(named).gel_id == "G7"
    assert read_origin(old().manifest).gel_id is None


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """The old bundle, five presses on the new gel, and its free gel."""
    write_bundle(tmp_path / "old", old_fit().files)
    rng = np.random.default_rng(8)
    (tmp_path / "presses").mkdir()
    for k in range(5):
        save(tmp_path / "presses" / f"bolt_crest_s{k:03d}_p00.png", picture(rng, 1.0, TINT))
    save(tmp_path / "free.png", picture(rng, 0.0, TINT))
    return tmp_path


def save(path: Path, rgb: U8) -> None:
    cv2.imwrite(str(path), rgb[..., ::-1])


def called(files: Path, *options: str) -> Outcome:
    words = files / "old", files / "presses", "--no-contact", files / "free.png", "-o", files / "new"
    return gelgate("bundle", "carry", *words, *options)


def test_on_the_command_line_a_bundle_is_written_and_its_promise_printed(files: Path) -> None:
    """It loads, with the sentences that `fit` prints."""
    done = called(files, "--gel", "G2", "--threads", "1")

    assert done.code == 0, done.err
    assert "carried over to another gel" in done.out
    assert "5 presses, counted as 5 pieces: at best 17 % (1 in 6)" in done.out
    assert read_origin(Bundle.load(files / "new").manifest).gel_id == "G2"


def test_on_the_command_line_presses_of_another_size_are_refused(files: Path) -> None:
    """One sentence, and nothing is written."""
    save(files / "presses" / "bolt_crest_s000_p00.png", np.full((100, 100, 3), 90, np.uint8))
    done = called(files)

    assert "1 of 5 pictures cannot be used" in done.err
    assert not (files / "new").exists()
