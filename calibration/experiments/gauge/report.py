"""The report of a gauge study: sections with sentences and tables, as Markdown or CSV."""

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import tzinfo
from typing import Final

import numpy as np

from calibration.experiments.gauge.agreement import Agreement, Kappa, Share, agreement
from calibration.experiments.gauge.gauge import (
    POOLED_ABOVE,
    Drift,
    Gauge,
    by_average_and_range,
    drift,
    gauge_by_anova,
)
from calibration.experiments.gauge.plan import Material
from edge.clock import local_time

__all__ = ["FORMATS", "Section", "csv_tables", "markdown", "report"]


@dataclass(frozen=True)
class Section:
    """A title, sentences, and at most one table."""

    title: str
    sentences: tuple[str, ...] = ()
    head: tuple[str, ...] = ()
    """The names of the columns; empty without a table."""
    rows: tuple[tuple[str, ...], ...] = ()
    """Rows of as many cells each, as printed."""


def report(study: Material, zone: tzinfo | None = None) -> list[Section]:
    """Every section, in order. A score without any variation has no gauge R&R, and its section says so.

    zone: of the times; None for that of this machine.
    """
    return [_about(study, zone), *_gauge(study), *_attribute(study), _drift(study)]


def _about(study: Material, zone: tzinfo | None) -> Section:
    plan, first, last = study.plan, study.presses[0], study.presses[-1]
    facts = {
        "study": plan.study_id,
        "part": f"{first.part}/{first.position}",
        "sensor, gel": f"{first.serial}, {first.gel_id}",
        "bundle": first.bundle_id[:16],
        "threshold": _number(first.threshold),
        "pressed": f"{local_time(first.time_ns, zone)} to {local_time(last.time_ns, zone)}",
        "order": f"random, seed {plan.seed}",
        "planned": f"{len(plan.pieces)} pieces x {len(plan.operators)} operators x {plan.repeats} repeats",
        "analysed": f"{len(study.pieces)} x {len(study.operators)} x {study.repeats}",
    }
    return Section("Study", tuple(_gaps(study)), ("fact", "value"), tuple(facts.items()))


def _gaps(study: Material) -> Iterator[str]:
    if study.missing:
        yield (
            f"The study is not complete: {study.missing} presses of the plan have no score. The analysis is that of "
            f"the largest table without gaps, which leaves out {study.left_out} presses."
        )
    if study.rejected:
        words = ", ".join(f"{name} {number}" for name, number in sorted(study.rejected.items()))
        yield f"Presses without a score, pressed again: {sum(study.rejected.values())} (by operator: {words})."
    if study.void:
        yield f"Presses that the operator repeated: {study.void}; they do not count and stay in the database."


def _gauge(study: Material) -> list[Section]:
    try:
        found = gauge_by_anova(study.scores)
    except ValueError as error:
        return [Section("Gauge R&R of the score", (f"There is none: {error}.",))]
    return [_components(found), _variance(found), _by_ranges(study)]


def _components(found: Gauge) -> Section:
    sure = f"{found.confidence:.0%}"
    rows = tuple(
        (
            _NAMES[one.name],
            _number(one.sd),
            f"{_number(one.low)} to {_number(one.high)}",
            f"{one.percent:.1f}",
            f"{one.percent_low:.1f} to {one.percent_high:.1f}",
            f"{one.contribution:.1f}",
        )
        for one in found.components
    )
    grr = found.component("GRR")
    sentences = (
        f"%GRR is {grr.percent:.1f} ({sure}: {grr.percent_low:.1f} to {grr.percent_high:.1f}): "
        f"{_grr_word(grr.percent)}. "
        "AIAG: below 10 acceptable, up to 30 depending on the use, above 30 not acceptable.",
        f"Distinct categories (ndc): {found.ndc} ({sure}: {found.ndc_low} to {found.ndc_high}); AIAG asks for 5 or "
        "more.",
    )
    head = (
        "component",
        "standard deviation",
        f"{sure} interval",
        "% of TV",
        f"{sure} interval",
        "% of variance",
    )
    return Section("Gauge R&R of the score, analysis of variance", sentences, head, rows)


_NAMES = {
    "EV": "repeatability (EV)",
    "AV": "operators (AV)",
    "INT": "operators x pieces (INT)",
    "GRR": "gauge R&R (GRR)",
    "PV": "pieces (PV)",
    "TV": "total (TV)",
}


def _grr_word(percent: float) -> str:
    if percent < 10:
        return "acceptable"
    return "acceptable for some uses" if percent <= 30 else "not acceptable"


def _variance(found: Gauge) -> Section:
    rows = tuple(
        (
            row.name,
            f"{row.ss:.6g}",
            str(row.df),
            f"{row.ms:.6g}",
            _optional(row.f, ".3f"),
            _probability(row.p),
        )
        for row in found.rows
    )
    interaction = next(row for row in found.rows if row.name == "interaction")
    word = "pooled with repeatability" if found.is_pooled else "kept"
    sentence = f"The interaction is {word}: its p is {interaction.p:.3f}, the limit is {POOLED_ABOVE:g}."
    return Section("Table of variance", (sentence,), ("source", "SS", "df", "MS", "F", "p"), rows)


def _by_ranges(study: Material) -> Section:
    found = by_average_and_range(study.scores)
    names = ("ev", "av", "grr", "pv", "tv")
    rows = tuple(
        (_NAMES[name.upper()], _number(getattr(found, name)), f"{found.percent(name):.1f}") for name in names
    )
    sentences = (
        f"ndc {found.ndc}. Mean range {_number(found.mean_range)}; upper limit of a range "
        f"{_number(found.upper_range)}: "
        f"{found.cells_above} of {study.scores.shape[0] * study.scores.shape[1]} cells are above it.",
        "This method has no interaction and no intervals; the analysis of variance is the one to decide by.",
    )
    head = ("component", "standard deviation", "% of TV")
    return Section("Gauge R&R of the score, averages and ranges", sentences, head, rows)


def _attribute(study: Material) -> list[Section]:
    found = agreement(study.verdicts, study.operators, study.known)
    words = ", ".join(f"{number} {word}" for word, number in found.verdicts.items())
    return [
        _operators(study, found, f"Verdicts: {words}."),
        _kappas(study, found),
    ]


def _operators(study: Material, found: Agreement, verdicts: str) -> Section:
    head = ("operator", "agrees with itself", "95 %", "effectiveness", "95 %", "misses", "false alarms")
    rows = [
        (
            one.name,
            *_share(one.within),
            *_share(one.effectiveness),
            _share(one.misses)[0],
            _share(one.false_alarms)[0],
        )
        for one in found.appraisers
    ]
    rows.append(("all operators", *_share(found.between), *_share(found.with_known), "", ""))
    sentences = [verdicts, _KNOWN if study.known is not None else _NOT_KNOWN]
    return Section("Agreement of verdicts, by piece", tuple(sentences), head, tuple(rows))


_KNOWN = (
    "Effectiveness: pieces with the right verdict in every repeat. Misses: passes among the decisions on bad pieces. "
    "False alarms: decisions on good pieces that are no pass; unsure is one. AIAG: effectiveness 90 % or more, misses "
    "at most 2 %, false alarms at most 5 % are acceptable; 80 %, 5 % and 10 % are marginal. Limits are those of "
    "Clopper and Pearson."
)
_NOT_KNOWN = (
    "It is not known of every piece whether it is good or bad, so there is no effectiveness, no rate of misses and no "
    "rate of false alarms: name bad pieces in `gelgate lab msa plan --bad`."
)


def _kappas(study: Material, found: Agreement) -> Section:
    rows = [(f"{one} and {other} (Cohen)", *_kappa(kappa)) for one, other, kappa in found.pairs]
    rows += [
        (f"{one.name} and the known verdict (Cohen)", *_kappa(one.kappa))
        for one in found.appraisers
        if one.kappa is not None
    ]
    rows.append(("all decisions (Fleiss)", *_kappa(found.fleiss)))
    sentences = ["AIAG: kappa above 0.75 is good agreement, below 0.40 poor."]
    if len(found.verdicts) == 1:
        (word,) = found.verdicts
        sentences.append(
            f"Every verdict is {word}, so agreement is all by chance and kappa is not defined: add pieces of the other "
            "kind."
        )
    head = ("between", "kappa", "standard error", "agreement", "by chance")
    return Section("Kappa", tuple(sentences), head, tuple(rows))


def _kappa(found: Kappa) -> tuple[str, str, str, str]:
    value = "not defined" if found.value is None else f"{found.value:.3f}"
    return value, _optional(found.standard_error, ".3f"), f"{found.observed:.1%}", f"{found.expected:.1%}"


def _drift(study: Material) -> Section:
    presses = study.presses
    found = drift(
        [float(one.score or 0.0) for one in presses],
        [(one.piece, one.operator) for one in presses],
        list(range(len(presses))),
    )
    title = "Drift while the study ran"
    if found is None:
        return Section(title, ("There are too few presses to test it.",))
    return Section(title, tuple(_drift_sentences(found, study)))


def _drift_sentences(found: Drift, study: Material) -> Iterator[str]:
    spread = float(np.std(study.scores)) or 1.0
    yield (
        f"Each press wears the gel. Over {found.presses} presses the score changed by {_number(found.total)} (95 %: "
        f"{_number(found.low)} to {_number(found.high)}), p {found.p:.3f}; one score varies by {_number(found.sd)} "
        "around that line."
    )
    if found.is_found:
        yield (
            f"The drift is real, and {abs(found.total) / spread:.1f} times the standard deviation of all scores: it is "
            "in the repeatability above. Look at the gel, and at what else changed with time."
        )
    else:
        yield "No drift is found beyond chance."


def _share(one: Share | None) -> tuple[str, str]:
    if one is None:
        return "", ""
    if one.share is None or one.limits is None:
        return "none of that kind", ""
    low, high = one.limits
    return f"{one.found}/{one.of} = {one.share:.1%}", f"{low:.1%} to {high:.1%}"


def _optional(value: float | None, how: str) -> str:
    return "" if value is None else format(value, how)


def _probability(p: float | None) -> str:
    if p is None:
        return ""
    return f"{p:.4f}" if p >= 0.00005 else "< 0.0001"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"


def markdown(title: str, sections: Sequence[Section]) -> str:
    """The report as Markdown with its columns in line, for a terminal as well."""
    parts = [f"# {title}"]
    for section in sections:
        parts += ["", f"## {section.title}"]
        parts += [text for sentence in section.sentences for text in ("", sentence)]
        if section.head:
            rows = [[cell.replace("|", "\\|") for cell in row] for row in (section.head, *section.rows)]
            widths = [max(3, *map(len, column)) for column in zip(*rows, strict=True)]
            rows.insert(1, ["-" * width for width in widths])
            parts += ["", *("| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in rows)]
    return "\n".join(parts) + "\n"


def csv_tables(title: str, sections: Sequence[Section]) -> str:
    """Every sentence and table, with the section's title in the first column."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["report", title])
    for section in sections:
        writer.writerows([section.title, sentence] for sentence in section.sentences)
        if section.head:
            writer.writerows([section.title, *row] for row in (section.head, *section.rows))
    return out.getvalue()


FORMATS: Final[Mapping[str, Callable[[str, Sequence[Section]], str]]] = {".md": markdown, ".csv": csv_tables}
"""Ending of a file's name to its form."""
