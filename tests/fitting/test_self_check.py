"""The checks of a fit's result: what is not proven, and outliers among the presses."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import tiny_fit
import turned_parts as parts
from registered_bundle import fitted, nominal

from calibration.fitting.damage.damaged_presses import DamagedPresses
from calibration.fitting.fit import fit_files
from calibration.fitting.limits.held_out import HeldOut, ScoredPresses
from calibration.fitting.limits.limit_choice import DamageFound, Evidence, choose_limit
from calibration.fitting.presses.nominal_presses import NominalPresses
from calibration.fitting.self_check import (
    apart_warnings,
    damage_facts,
    drift_warnings,
    find_remedies,
    standing_apart,
    unproven_warnings,
)
from edge.core.contact.mask import Touch
from edge.core.imaging import known_profiles


def scores(n: int, *high: tuple[int, float]) -> np.ndarray:
    """n scores between 9 and 11, but for those that are given."""
    found = np.random.default_rng(n).uniform(9, 11, n)
    for number, score in high:
        found[number] = score
    return found


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        *((scores(n, (3, 30)), [3]) for n in (8, 19, 24, 60)),
        (scores(24, (5, 28), (7, 30)), [7, 5]),
        (scores(24, *((k, 30) for k in range(4))), []),
        (np.full(12, 3.0), []),
    ],
)
def test_a_press_far_above_all_others_stands_apart(given: np.ndarray, expected: list[int]) -> None:
    """Two do not hide each other; a group of four is another way to look; copies of one press are all alike."""
    assert standing_apart(given) == expected


@pytest.mark.parametrize("draw", ["normal", "exponential", "lognormal"])
def test_sound_presses_seldom_stand_apart(draw: str) -> None:
    """1,000 sets of 24 scores, also with long tails: fewer than one in ten has an outlier."""
    rng = np.random.default_rng(1)
    sets = {
        "normal": rng.normal,
        "exponential": rng.exponential,
        "lognormal": lambda size: rng.lognormal(0, 0.5, size),
    }
    assert np.mean([bool(standing_apart(drawn)) for drawn in sets[draw](size=(1000, 24))]) < 0.1


def test_the_warning_names_the_press_and_the_way_out() -> None:
    """With its score and the highest of the others."""
    high = np.linspace(9, 11, 20)
    high[4] = 90
    (said,) = apart_warnings(high, [f"good/{k}.png" for k in range(20)])
    assert "press 'good/4.png' stands apart" in said
    assert "90 where they reach 11" in said
    assert "--leave-out 'good/4.png'" in said


def evidence(spots: dict[int, float]) -> Evidence:
    """24 presses with the same damage in each, and a spot of this height elsewhere in some of them."""
    sound = 1 + 0.02 * np.random.default_rng(1).random((24, 48, 48))
    for press, height in spots.items():
        sound[press, 30, 30] += height
    near = np.zeros(sound.shape, np.bool_)
    near[:, 9:12, 9:12] = True

    def score(maps: np.ndarray) -> ScoredPresses:
        return ScoredPresses(maps.astype(np.float32), maps.max(axis=(1, 2)).astype(np.float64))

    damage = DamagedPresses(np.zeros((24, 1, 1, 3), np.uint8), np.arange(24), near)
    held_out = HeldOut(score(sound), score(sound + 0.5 * near))
    parts = [np.arange(k, 24, 4) for k in range(4)]
    return Evidence(held_out, score(0.9 * sound), None, damage, parts, (None,) * 24, 0.05, 4.0)


@pytest.mark.parametrize(
    ("separated", "found", "said"),
    [
        (None, None, []),
        (0.84, DamageFound(15, 48), []),
        (0.84, DamageFound(11, 48), ["finds 11 of 48 small pieces of damage"]),
        (0.51, DamageFound(20, 48), ["0.51 is separated from sound presses, as by chance"]),
        (
            None,
            DamageFound(1, 48, "dent of 0.1 mm: 1 of 6"),
            [
                "finds 1 of 48 small pieces of damage rendered into its own presses (dent of 0.1 mm: 1 of 6): it"
            ],
        ),
        (0.51, DamageFound(0, 48), ["0.51 is separated", "finds 0 of 48"]),
    ],
)
def test_empty_evidence_is_said(separated: float | None, found: DamageFound | None, said: list[str]) -> None:
    """A bundle that does not see its own damage is not proven, chance before few; one with evidence has no warning."""
    warned = unproven_warnings(separated, found)
    assert len(warned) == len(said)
    for sentence, words in zip(warned, said, strict=True):
        assert sentence.startswith("not proven: ")
        assert words in sentence


def test_what_is_found_is_said_by_size_and_where_it_is_little_what_finds_more() -> None:
    """Nothing is looked for where half is found, nor where so little is that the bundle is not proven."""
    for found, more in ((24, False), (23, True), (15, True), (14, False)):
        said = damage_facts(DamageFound(found, 48, sizes="dent of 0.1 mm 5 of 6"), lambda: ["press more"])
        assert said == {"damage_found": "found by size: dent of 0.1 mm 5 of 6" + "; press more" * more}
    assert damage_facts(None, lambda: ["press more"]) == {}

    named = evidence(spots={})
    names = tuple(("dent of 0.05 mm", "dent of 0.1 mm", "bump of 0.05 mm")[k % 3] for k in range(24))
    sized = replace(named, damage=replace(named.damage, names=names))
    assert sized.count_found(choose_limit(sized)).sizes == (
        "bump of 0.05 mm 8 of 8, dent of 0.1 mm 8 of 8, dent of 0.05 mm 8 of 8"
    )


def test_a_remedy_is_said_with_what_it_finds_and_no_other_is() -> None:
    """One dirty press, then presses that lie off, then a bank of fewer presses that finds less."""

    profile = known_profiles.profile("mini_lr")
    across = np.arange(24) * profile.pixels_per_mm / profile.size[0] / 2
    touches = tuple(Touch(0.1, float(x), 0.5) for x in across)
    frames = np.zeros((24, 1, 1, 3), np.uint8)
    presses = NominalPresses(frames, tuple(f"{k}.png" for k in range(24)), touches=touches)

    def remedies(found: Evidence, fewer: HeldOut | None = None) -> str:
        apart = fewer or found.held_out
        return "; ".join(find_remedies(found, choose_limit(found), presses, profile, lambda folds: apart))

    clean = evidence(spots={})
    assert remedies(clean) == ""
    dirty = remedies(evidence(spots={5: 9.0}))
    assert "without its highest press it finds 23 of 23: look whether '5.png'" in dirty
    assert "--alpha 0.1 it finds 24 of 24" in dirty
    assert "press more pieces" not in dirty
    far = remedies(evidence(spots={k: 9.0 for k in range(24) if not 6 <= k < 18}))
    assert "within 3.2 mm of their middle it finds 12 of 12, beyond 0 of 12: hold" in far
    assert "without its highest" not in far
    few = evidence(spots=dict.fromkeys(range(24), 9.0)).held_out
    assert "press more pieces" in remedies(clean, fewer=few)


def test_a_bundle_that_misses_its_own_damage_says_so_first() -> None:
    """Presses with blots larger than the damage rendered into them: 0 of 24 found; without blots no such warning."""
    frames = np.stack([parts.press(parts.BLOCK, seed=k) for k in range(12)])
    rng = np.random.default_rng(0)
    blots = np.stack([cv2.GaussianBlur(rng.normal(0, 540, frames.shape[1:3]), (0, 0), 6) for _ in frames])
    blotted = np.clip(frames + blots[..., None], 0, 255).astype(np.uint8)
    for pictures, is_proven in ((frames, True), (blotted, False)):
        first = fitted(nominal(pictures), "never").manifest.provenance.warnings[0]
        assert ("not proven: the bundle finds 0 of 24" in first) is not is_proven


def test_a_bundle_into_whose_presses_no_damage_could_be_rendered_is_not_proven() -> None:
    """Without a free gel, without contact, of few presses; not where a plain limit was asked for."""
    frames = np.stack([parts.press(parts.BLOCK, seed=k) for k in range(6)])
    untouched = parts.free_gel() ^ np.random.default_rng(0).integers(0, 2, frames.shape, np.uint8)
    for presses in (nominal(frames, no_contact=None), nominal(untouched)):
        first = fitted(presses).manifest.provenance.warnings[0]
        assert first.startswith("not proven: nothing shows what damage the bundle finds: no contact")
        assert "--no-contact; press damaged parts" in first
    few = fitted(nominal(frames[:3]), augment="auto").manifest.provenance.warnings[0]
    assert few.startswith("not proven: nothing shows what damage the bundle finds: of fewer than 4 presses")
    asked = fitted(nominal(frames, no_contact=None), limit="plain").manifest.provenance.warnings
    assert not any(said.startswith("not proven") for said in asked)


def pressed_at(
    places: np.ndarray, names: list[str] | None = None, pieces: list[str] | None = None
) -> list[str]:
    """Say what is warned of presses at these places of the view, in shares of it, (n, 2)."""
    touches = tuple(Touch(0.1, *place) for place in places.tolist())
    in_order = tuple(names or [f"{k}.png" for k in range(len(places))])
    frames = np.zeros((len(places), 2, 2, 3), np.uint8)
    own = NominalPresses(frames, in_order, tuple(pieces or ()), touches=touches)
    return drift_warnings(own, known_profiles.profile("cropped_lr"))


# As a person presses a ball: column by column, from one side of the view to the other.
COLUMNS = np.array([(x, y) for x in np.linspace(0.1, 0.9, 6) for y in np.linspace(0.1, 0.9, 8)])


@pytest.mark.parametrize("count", [4, 6, 8, 12, 20])
def test_presses_each_beside_the_one_before_are_not_proven(count: int) -> None:
    """The first ones of 48, also where names sort otherwise than their numbers; not such as are drawn by chance."""
    (said,) = pressed_at(COLUMNS[:count])
    assert said.startswith("not proven: each contact lies beside the one before it, all within ")
    assert "set the part down anew before each press" in said
    by_name = sorted(range(count), key=str)
    assert pressed_at(COLUMNS[by_name], [f"{k}.png" for k in by_name]) == [said]
    drawn = [np.random.default_rng(seed).permutation(len(COLUMNS))[:count] for seed in range(200)]
    assert np.mean([bool(pressed_at(COLUMNS[rows])) for rows in drawn]) <= 0.03


def test_presses_that_spread_are_not_said_to_drift() -> None:
    """All of the view; a fixture; a hand; each of six pieces pressed four times; three presses; no free gel."""
    rng = np.random.default_rng(0)
    assert not pressed_at(COLUMNS)
    assert not pressed_at(0.5 + 0.01 * COLUMNS[:12])
    hand = [bool(pressed_at(0.5 + rng.normal(0, 0.06, (4, 2)))) for _ in range(1000)]
    assert np.mean(hand) <= 0.03
    places = np.array([(0.4, 0.6), (0.6, 0.5), (0.4, 0.4), (0.6, 0.6), (0.5, 0.4), (0.4, 0.5)])
    again = np.repeat(places, 4, axis=0)
    assert not pressed_at(again, pieces=[f"{k // 4}" for k in range(24)])
    assert pressed_at(again)
    assert not pressed_at(COLUMNS[:3])
    assert not drift_warnings(tiny_fit.presses(6), known_profiles.profile("cropped_lr"))


def test_a_fit_says_that_its_presses_drift() -> None:
    """First, and not where the threshold is given: then no rate is promised."""
    touches = tuple(Touch(0.1, 0.5, down) for down in np.linspace(0, 1, 6).tolist())
    for threshold, is_said in ((None, True), (3.0, False)):
        given = replace(tiny_fit.config(), threshold=threshold)
        warnings = fit_files(
            tiny_fit.presses(6, touches=touches), given, created=""
        ).manifest.provenance.warnings
        assert any("each contact lies beside the one before it" in said for said in warnings[:2]) is is_said
