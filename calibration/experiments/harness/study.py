"""What every study does: check its options, extract features once, run the cells, and leave rows."""

import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Any, get_args

from calibration.dataset import Dataset
from calibration.experiments.harness.cells import Cell, Setting, Split
from calibration.experiments.harness.cluster import check_address
from calibration.experiments.harness.evidence import stable_from
from calibration.experiments.harness.material import Material, Place, material, taps_of
from calibration.experiments.harness.presses import hold_out
from calibration.experiments.harness.published import stable_fraction
from calibration.experiments.harness.rows import ROWS_FILE, Rows, frame
from calibration.experiments.harness.runner import run
from calibration.fitting.trunks import every_cut
from calibration.progress import Show, progress
from edge import registry
from edge.core.detector import Mode
from edge.core.errors import ConfigError, DatasetError, FitError
from edge.core.suggest import suggestion
from edge.extras import needs

__all__ = [
    "ROWS_FILE",
    "Evaluation",
    "Options",
    "check_same",
    "choose_places",
    "make_cells",
    "methods_to_compare",
    "positions_by_part",
    "require_known",
    "run_study",
]


@dataclass(frozen=True)
class Options:
    """What a study is asked for. Empty methods, modes, backbones and splits become the defaults.

    Errors: ConfigError for an unknown method, mode or split, an output that is a file, what is no address, or a missing
    extra.
    """

    dataset: Path
    output: Path
    cache: Path | None = None
    """The folder of features; None is a folder in the output."""
    parts: tuple[str, ...] = ()
    position: str | None = None
    """The reference position, None is each part's first."""
    target: str | None = None
    """The second position of `cross-position`, None is each part's second."""
    presses: int = 40
    """Nominal presses of the pool of `resolution` at most."""
    views: tuple[str, ...] = ()
    """Those of `resolution`, all if empty."""
    fractions: tuple[float, ...] = tuple(k / 20 for k in range(1, 21))
    """Shares of the pool of `good-fraction`, in (0, 1]; 5 to 100 % in steps of 5, as in the paper."""
    shots: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    """Numbers of presses of `good-fraction`: those that few-shot studies of the field report."""
    methods: tuple[str, ...] = ()
    modes: tuple[Mode, ...] = ()
    backbones: tuple[str, ...] = ()
    splits: tuple[Split, ...] = ()
    seeds: int = 10
    held_out: int = 20
    fraction: float | None = None
    """Of the pool, in (0, 1], that every method learns from; None is each method's stable one."""
    jobs: int = 1
    dask: str | None = None
    show: Show = progress

    def __post_init__(self) -> None:
        if self.output.exists() and not self.output.is_dir():
            raise ConfigError(
                f"the output '{self.output}' is a file; name a folder, new or of an earlier run"
            )
        needs("studies" if self.dask is None else "cluster", "study" if self.dask is None else "study --dask")
        if self.dask is not None:
            check_address(self.dask)
        defaults = {
            "parts": (),
            "methods": methods_to_compare(),
            "modes": ("corrected",),
            "backbones": ("tactile_resnet18",),  # of which the rows in docs/studies are
            "splits": ("press",),
        }
        for name, default in defaults.items():
            object.__setattr__(self, name, tuple(dict.fromkeys(getattr(self, name))) or default)
        require_known("mode", self.modes, get_args(Mode))
        require_known("split", self.splits, get_args(Split))
        require_known("method", self.methods, registry.names("detectors"))

    @property
    def features(self) -> Path:
        """The folder of the cache, absolute: a worker may have another working folder."""
        return (self.cache or self.output / "features").absolute()

    def fraction_of(self, method: str, mode: Mode, backbone: str, split: str) -> float:
        """Return the share of the pool that a method learns from: the one asked for, else the method's stable one.

        In `paper` mode a method of the paper has the paper's own; else rows of good-fraction in the output folder give
        it, those of another split where this one has none. Errors: ConfigError where it is not known.
        """
        if self.fraction is not None:
            return self.fraction
        if mode == "paper" and (paper := stable_fraction(method)) is not None:
            return paper
        file = self.output / ROWS_FILE
        rows = frame(file)
        wanted = {"study": "good-fraction", "method": method, "mode": mode, "backbone": backbone}
        for column, value in wanted.items():
            rows = rows[rows[column] == value] if column in rows else rows
        fraction = None if rows.empty else stable_from(rows[rows["split"] == split]) or stable_from(rows)
        if fraction is None:
            raise ConfigError(
                f"the stable fraction of {method} ({mode}, {backbone}) is not known: '{file}' has no rows of "
                "good-fraction with it; run `gelgate lab study good-fraction` into the same folder, or give --fraction"
            )
        return fraction

    def taps(self) -> dict[str, tuple[str, ...]]:
        """Return by backbone the taps that all methods read. Errors: ConfigError, FitError."""
        return {name: taps_of(self.methods, self.modes, name) for name in self.backbones}


@dataclass(frozen=True)
class Evaluation:
    """Evaluates the cells of a study."""

    dataset: Path
    cache: Path
    taps: Mapping[str, tuple[str, ...]]
    """By backbone, those that are extracted for all cells."""

    def place(self, cell: Cell, position: str | None = None) -> Place:
        """Return where the cell's features come from. position: another one than the cell's."""
        where = cell.part, position or cell.position, cell.backbone
        return Place(self.dataset, self.cache, *where, self.taps[cell.backbone])

    def places(self, cell: Cell) -> tuple[Place, ...]:
        """Return every place that the cell needs."""
        return (self.place(cell),)

    def check(self, cell: Cell, *materials: Any) -> None:
        """Check that presses can be held out, before any cell runs. Errors: DatasetError."""
        for study_material in materials:
            hold_out(study_material.presses, int(cell.setting("held_out")), cell.split)

    def measure(self, cell: Cell, *materials: Any) -> Mapping[str, Any]:
        """Return the columns of the cell's row, from the materials of its places."""
        raise NotImplementedError

    def __call__(self, cell: Cell) -> Mapping[str, Any]:
        return self.measure(cell, *map(material, self.places(cell)))


def methods_to_compare() -> tuple[str, ...]:
    """Every detector but the baselines."""
    return tuple(n for n in registry.names("detectors") if not registry.detector(n).is_baseline)


def require_known(what: str, given: Iterable[str], names: Iterable[str]) -> None:
    """Check names. Errors: ConfigError, with the nearest name, for one that is not known."""
    for name in given:
        if name not in (known := tuple(names)):
            raise ConfigError(f"no {what} is named '{name}'; {suggestion(name, known)}")


def positions_by_part(dataset: Dataset) -> dict[str, list[str]]:
    """Return the positions of each part, in their order."""
    known: dict[str, list[str]] = {}
    for part, position in dataset.positions:
        known.setdefault(part, []).append(position)
    return known


def choose_places(dataset: Dataset, parts: Sequence[str], position: str | None) -> list[tuple[str, str]]:
    """(part, position) of each part: the position given, or its first by name. Errors: DatasetError."""
    known = positions_by_part(dataset)
    for part in parts:
        if part not in known:
            raise DatasetError(f"dataset '{dataset.root}' has no part '{part}'; {suggestion(part, known)}")
    places = [(part, position or known[part][0]) for part in parts or known]
    for part, place in places:
        dataset.select(part, place)
    return places


def make_cells(
    study: str, options: Options, place: tuple[str, str], varied: Sequence[Mapping[str, Setting]]
) -> list[Cell]:
    """Return the cells of a part and position with each of some settings.

    Those without a number of presses have each method's fraction. The seed is the outer loop within a backbone, so that
    an interrupted study has complete curves of fewer seeds, and the time left is estimated from cells of every kind.
    Errors: ConfigError for a method whose stable fraction is not known.
    """
    fraction = cache(options.fraction_of)

    def settings(own: Mapping[str, Setting], *setup: Any) -> tuple[tuple[str, Setting], ...]:
        learnt = {} if own.keys() & {"fraction", "shots"} else {"fraction": fraction(*setup)}
        return tuple(sorted({**own, **learnt, "held_out": options.held_out}.items(), key=itemgetter(0)))

    return [
        Cell(study, *place, method, mode, backbone, split, seed, settings(own, method, mode, backbone, split))
        for backbone in options.backbones
        for seed in range(options.seeds)
        for own in varied
        for split in options.splits
        for mode in options.modes
        for method in options.methods
    ]


def run_study(cells: Sequence[Cell], evaluation: type[Evaluation], options: Options) -> Rows:
    """Extract features, check all, and run the cells that have no row in the output folder yet.

    Errors: DatasetError, FitError, StoreError; ConfigError where rows of the same places are from other pictures;
    else as `calibration.experiments.harness.runner.run`.
    """
    evaluate = evaluation(options.dataset.absolute(), options.features, options.taps())
    materials = {
        place: _extract(place, options) for place in dict.fromkeys(chain(*map(evaluate.places, cells)))
    }
    for remark in dict.fromkeys(chain(*(found.presses.remarks for found in materials.values()))):
        _say(remark)
    for cell in {(evaluate.places(cell), cell.split): cell for cell in cells}.values():
        evaluate.check(cell, *(materials[place] for place in evaluate.places(cell)))
    rows = Rows(options.output / ROWS_FILE, _say)
    studies = {cell.study for cell in cells}
    check_same((row for row in rows.read() if row["study"] in studies), list(materials.values()), rows.path)
    run(cells, evaluate, rows, jobs=options.jobs, dask=options.dask, progress=options.show)
    return rows


def _extract(place: Place, options: Options) -> Material:
    place.require_room()
    with options.show(f"features of {place}", 100) as advance:
        return place.extract(lambda share: advance(int(100 * share)), min(options.jobs, os.cpu_count() or 1))


def check_same(rows: Iterable[Mapping[str, Any]], materials: Sequence[Material], path: Path) -> None:
    """Check rows. Errors: ConfigError where they are from other pictures, another trunk or another program.

    Other methods and the other mode read other layers: rows from the same trunk, cut after another one, are continued.
    """
    for row in rows:
        for known in materials:
            if known.place.covers(row):
                _check_facts(row, known, path)


def _check_facts(row: Mapping[str, Any], known: Material, path: Path) -> None:
    for name, what in _FACTS.items():
        now = known.facts[name]
        row_fact = row.get(name, now)
        if row_fact != now and not (name == "trunk_sha256" and row_fact in _cuts(known.place)):
            raise ConfigError(
                f"'{path}' has rows of {row['part']}/{row['position']} from {what} ({row_fact}, now {now}); choose "
                "another output folder"
            )


def _cuts(place: Place) -> set[str]:
    """Return hashes, as in rows, of every cut of a backbone's trunk that a study may have used."""
    asked: set[tuple[str, ...]] = {()}
    for mode in get_args(Mode):
        with suppress(FitError):  # a backbone without the layers of one mode has rows of the other only
            asked.add(taps_of(methods_to_compare(), (mode,), place.backbone))
    return {place.show(cut).sha256[:16] for taps in asked for cut in every_cut(place.backbone, taps)}


_FACTS = {
    "pictures_sha256": "other pictures",
    "trunk_sha256": "another trunk",
    "program": "another version of the program",
}


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr)
