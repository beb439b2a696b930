"""The table `[overview]`: what it refuses, with which sentence, and where its paths begin."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from station import station_config

from edge.config import load_config
from edge.core.errors import ConfigError
from edge.core.overview.view import Zone
from edge.features.overview import read_rules


def written(folder: Path, table: str = "") -> Path:
    table = f'[overview]\nplugin = "virtual_overview"\n{table}'
    return station_config(folder, folder / "presses", folder / "bundle", tables=table)


def test_without_the_table_there_is_no_overview_camera(tmp_path: Path) -> None:
    path = station_config(tmp_path, tmp_path / "presses", tmp_path / "bundle")

    assert load_config(path).overview is None


def test_a_table_with_a_plugin_alone_asks_for_nothing(tmp_path: Path) -> None:
    """Stills are attached and no press is refused."""
    table = load_config(written(tmp_path)).overview

    assert table is not None
    assert not read_rules(table).is_asking


def test_the_table_is_the_rules(tmp_path: Path) -> None:
    """Every key reaches the rules, and the picture's path begins at the file's folder."""
    cv2.imwrite(str(tmp_path / "empty.png"), np.full((48, 64), 90, np.uint8))
    text = 'codes = ["apriltag", "qr"]\napriltag_family = "25h9"\n'
    text += 'part_pattern = "(?P<part>.)-.*"\nparts = { a = "PZ0" }\n'
    text += 'empty = "empty.png"\npresent_share = 0.1\nregion = [0.5, 0, 0.5, 1]'
    table = load_config(written(tmp_path, text)).overview
    assert table is not None
    rules = read_rules(table)

    assert (rules.codes, rules.family, rules.parts) == (("apriltag", "qr"), "25h9", {"a": "PZ0"})
    assert rules.pattern is not None
    assert rules.pattern.pattern == "(?P<part>.)-.*"
    assert rules.empty is not None
    assert (rules.empty.shape, int(rules.empty[0, 0])) == ((48, 64), 90)
    assert (rules.present_share, rules.zone, rules.is_asking) == (0.1, Zone(0.5, 0, 0.5, 1), True)


def test_a_path_of_the_plugin_begins_at_the_files_folder(tmp_path: Path) -> None:
    text = 'options = { recording = "parts" }'
    path = written(tmp_path, text)
    path.write_text(path.read_text().replace('"virtual_overview"', '"recorded"'))
    table = load_config(path).overview

    assert table is not None
    assert table.options["recording"] == str(tmp_path / "parts")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('codes = ["ean13"]', "overview.codes"),
        ("select = true", "need codes"),
        ('part_pattern = "(?P<part>.*)"', "need codes"),
        ('codes = ["qr"]\npart_pattern = "(.*)"', "no group `part`"),
        ('codes = ["qr"]\npart_pattern = "(?P<part>"', "no regular expression"),
        ("region = [0.5, 0, 0.6, 1]", "lies in it, found 0.5, 0, 0.6, 1"),
        ("region = [0, 0, 1]", "overview.region"),
        ("presence = 0.1", "presence"),
        ('options = { part = "PZ0" }', "overview.options"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load_config(written(tmp_path, text))

    assert sentence in str(refused.value)


def test_an_unknown_overview_camera_is_refused_with_the_nearest_name(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text().replace("virtual_overview", "usb_kamera"))

    with pytest.raises(ConfigError, match="usb_camera"):
        load_config(path)


def test_the_example_of_the_manual_loads(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs/operations.md").read_text(encoding="utf-8")
    table = page.partition("[overview]\n")[2].partition("```")[0]
    path = written(tmp_path)
    path.write_text(path.read_text().replace('plugin = "virtual_overview"\n', table))
    overview = load_config(path).overview

    assert overview is not None
    assert (overview.codes, overview.parts) == (("qr", "apriltag"), {"17": "PZ0"})


def test_a_data_matrix_needs_its_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The check before a start says what to install."""
    table = load_config(written(tmp_path, 'codes = ["datamatrix"]')).overview
    assert table is not None
    monkeypatch.setitem(sys.modules, "zxingcpp", None)
    with pytest.raises(
        ConfigError, match=r"datamatrix needs zxingcpp, .*; pip install 'gelgate\[datamatrix\]'"
    ):
        read_rules(table)
