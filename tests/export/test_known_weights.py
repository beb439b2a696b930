"""Releases are known by their hash; licences are asked for, kept, and printed."""

import cv2
import numpy as np
import pytest
import tiny

from edge.core.errors import ConfigError
from edge.model.manifest import Manifest
from edge.model.manifest_facts import is_non_commercial, licence_of, licence_sentence
from export.known_weights import ENCODERS, RELEASES, check_release, encoder, stated_licence
from plugins.backbones.input_steps import apply_steps

V1, V2 = "95faca4d" + 56 * "0", "9ba9bcbe" + 56 * "0"


def test_v1_and_v2_are_told_apart_by_the_hash() -> None:
    """A V2 file where V1 was declared is refused; undeclared it is named; another file is unknown."""
    assert check_release(V1, "V1", "wide_resnet50_2", "a.pth") == "torchvision wide_resnet50_2 IMAGENET1K_V1"
    assert check_release(V2, None, "wide_resnet50_2", "a.pth").endswith("IMAGENET1K_V2")
    with pytest.raises(ConfigError, match=r"a\.pth are the V2 weights .*, V1 was declared"):
        check_release(V2, "V1", "wide_resnet50_2", "a.pth")
    with pytest.raises(ConfigError, match="not a resnet50; pass --topology wide_resnet50_2"):
        check_release(V1, None, "resnet50", "a.pth")
    assert check_release("0" * 64, None, "resnet18", "a.pth") == "unknown"
    assert check_release("0" * 64, "V1", "resnet18", "a.pth").startswith("V1 (stated")


PUBLISHED = {
    "resnet18": {"f37072fd": "V1", "5c106cde": "V1"},
    "resnet50": {"0676ba61": "V1", "19c8e357": "V1", "11ad3fa6": "V2"},
    "wide_resnet50_2": {"95faca4d": "V1", "9ba9bcbe": "V2"},
}
"""The names of torchvision's files, `<network>-<digits>.pth`, of release 0.28 and of those before 0.10."""


def test_releases_are_those_that_torchvision_publishes() -> None:
    """Every file of the three networks and no other, such as wide_resnet101_2-32ee1156."""
    found: dict[str, dict[str, str]] = {name: {} for name in PUBLISHED}
    for digits, release in RELEASES.items():
        found[release.topology][digits] = release.version
    assert found == PUBLISHED
    for digits, one in RELEASES.items():
        assert check_release(digits + "0" * 56, None, one.topology, "file") == one.name
    assert check_release("32ee1156" + 56 * "0", None, "wide_resnet101_2", "file") == "unknown"


def test_units_preprocessing_is_opencvs_resize() -> None:
    """Levels in 0..1, 128x160, linear without antialiasing."""
    steps = ENCODERS["unit"].steps
    assert steps is not None
    frames = np.random.default_rng(0).integers(0, 256, (1, 240, 320, 3), dtype=np.uint8)

    expected = cv2.resize(frames[0].astype(np.float32) / 255, (160, 128))

    np.testing.assert_allclose(apply_steps(steps, frames)[0].transpose(1, 2, 0), expected, atol=1e-5)


def test_encoders_have_licences() -> None:
    """Sparsh's is not for commercial use, the others are."""
    assert [name for name, one in ENCODERS.items() if is_non_commercial(one.licence)] == ["sparsh"]
    with pytest.raises(ConfigError, match="is named 'anytouch'; known: tvl, t3, sparsh, unit"):
        encoder("anytouch")


@pytest.mark.parametrize("text", [None, "", "  ", "two\nlines", "x" * 201])
def test_a_licence_is_one_short_line(text: str | None) -> None:
    """Nothing, several lines and long texts are refused."""
    with pytest.raises(ConfigError, match="the licence of a file"):
        stated_licence(text, "a file")


@pytest.mark.parametrize(
    ("licences", "expected"),
    [
        (("CC-BY-NC-4.0", "CC BY-NC-SA 4.0", "Non-commercial", "research only"), True),
        (("MIT", "Apache-2.0", "BSD-3-Clause", "own, for Nancy GmbH"), False),
    ],
)
def test_licences_that_forbid_commercial_use(licences: tuple[str, ...], expected: bool) -> None:
    """By the letters NC as a word, or in words; inside a word they say nothing."""
    assert [is_non_commercial(licence) for licence in licences] == [expected] * len(licences)


def manifest(**facts: object) -> Manifest:
    return tiny.tiny_files(facts=facts)[0]


def test_a_manifest_says_its_licences() -> None:
    """Of the detector and of the trunk, each once; nothing where nothing was stated."""
    assert licence_of(manifest()) is None
    assert licence_sentence(manifest()) is None
    both = manifest(licence="MIT", backbone={"licence": "CC-BY-NC-4.0"})
    assert licence_of(both) == "MIT, CC-BY-NC-4.0"
    assert licence_sentence(both) == (
        "licence of the weights MIT, CC-BY-NC-4.0: not for commercial use, not for production"
    )
    assert licence_of(manifest(licence="MIT", backbone={"licence": "MIT"})) == "MIT"
