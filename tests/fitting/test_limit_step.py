"""A fit chooses a limit from presses into which damage was rendered; what it publishes is in units of it."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_dome import PROFILE, REGION, dome_config, dome_presses

from calibration.fitting.damage.damaged_presses import SIZE_SHARES, SPOTS, render_damage
from calibration.fitting.fit import FitConfig, fit_files
from calibration.fitting.presses.nominal_presses import NominalPresses
from edge.model.manifest_facts import LIMIT, MISSING, choice_sentence
from edge.model.scorer import Scorer


@pytest.fixture(scope="module")
def presses() -> NominalPresses:
    """Eight presses of a dome."""
    return dome_presses(8)


@pytest.fixture(scope="module")
def config() -> FitConfig:
    return dome_config()


def test_small_damage_is_rendered_into_the_contact(presses: NominalPresses) -> None:
    """Sixteen spots in three sizes; the largest changes the picture near the damage, the rest by its
    compression. Without the free gel nothing is known of the part's height."""
    edited = render_damage(presses, PROFILE, REGION, np.random.default_rng(0))
    assert edited is not None
    assert len(edited) == SPOTS * len(SIZE_SHARES)
    largest = slice(len(SIZE_SHARES) - 1, None, len(SIZE_SHARES))
    changed = np.abs(edited.frames.astype(int) - presses.frames[edited.press]).sum(axis=3)[largest]
    near = edited.masks[largest]
    assert changed[near].mean() > 2 * changed[~near].mean()
    assert render_damage(replace(presses, no_contact=None), PROFILE, REGION, np.random.default_rng(0)) is None


def test_a_fit_says_what_it_chose(presses: NominalPresses, config: FitConfig) -> None:
    """The manifest has the share that every kind of limit finds, and scores without limit arrays stay raw."""
    manifest = fit_files(presses, config, created="").manifest
    found = manifest.facts["limit"]["found"]
    assert {"plain", "surroundings"} == found.keys()
    assert 0 < found["plain"] < 1
    assert choice_sentence(manifest.facts, LIMIT).startswith(manifest.facts["limit"]["kind"])
    assert (manifest.threshold.value == 1) == ("limit_grid" in manifest.bank)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"limit": "plain"}, "it was asked for"),
        ({"threshold": 9.0}, "the threshold was given"),
    ],
)
def test_a_fit_keeps_the_plain_limit(
    presses: NominalPresses, config: FitConfig, changes: dict[str, object], why: str
) -> None:
    """Where it is asked for, and where there is nothing to choose."""
    manifest = fit_files(presses, replace(config, **changes), created="").manifest  # type: ignore[arg-type]
    assert manifest.facts["limit"] == {"kind": "plain", "why": why, "found": {}}
    assert choice_sentence(manifest.facts, MISSING) == f"not checked: {why}"
    assert not [name for name in manifest.bank if name.startswith(("limit_", "relief_"))]


def unlike(presses: NominalPresses) -> NominalPresses:
    """The same presses three times over, deeper and less deep: the relief differs by a third from press to press."""
    assert presses.no_contact is not None
    rng, frames = np.random.default_rng(0), np.concatenate([presses.frames] * 3)
    free = presses.no_contact.mean(axis=0)
    deep = free + (frames - free) * (1 + 0.3 * rng.standard_normal((len(frames), 1, 1, 1)))
    shown = np.clip(np.rint(deep), 0, 255).astype(np.uint8)
    return NominalPresses(shown, tuple(map(str, range(len(shown)))), no_contact=presses.no_contact)


def test_unlike_presses_are_told_in_units_of_their_limit(presses: NominalPresses, config: FitConfig) -> None:
    """Where presses differ in depth a kind with surroundings is chosen: its threshold is 1, its scores
    are those of the scorer, and its arrays are in the bank."""
    fitted = fit_files(unlike(presses), config, created="")
    manifest = fitted.manifest
    assert manifest.facts["limit"]["kind"] == "surroundings"
    assert manifest.threshold.value == 1
    assert {"limit_grid", "limit_guard", "limit_window_up_rows"} <= set(manifest.bank)
    scored = Scorer(fitted.bundle(), 1).score(unlike(presses).frames[0])
    assert scored.anomaly_score == pytest.approx(float(scored.score_map.max()))
    assert scored.anomaly_score <= max(manifest.threshold.nominal_scores) + 1e-3
