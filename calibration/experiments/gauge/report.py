"""The report of a gauge study: sections with sentences and tables, as Markdown or CSV."""

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np

from calibration.experiments.gauge.gauge import (
    CONFIDENCE,
    POOLED_ABOVE,
    Gauge,
    Kappa,
    Share,
    cohen_kappa,
    count_shares,
    drift,
    fleiss_kappa,
    gauge_by_anova,
)
from calibration.experiments.gauge.plan import Material
from calibration.experiments.harness.markdown import markdown_table
from edge.clock import local_time
from edge.core.printable import write_count

__all__ = ["FORMATS", "markdown", "report_sections"]


class Section(NamedTuple):
    """A title, sentences, and at most one table."""

    title: str
    sentences: tuple[str, ...] = ()
    head: tuple[str, ...] = ()
    """The names of the columns; empty without a table."""
    rows: tuple[tuple[str, ...], ...] = ()
    """Rows of as many cells each, as printed."""


def report_sections(study: Material) -> list[Section]:
    """Every section, in order. A score without any variation has no gauge R&R, and its section says so."""
    return [_about(study), *_gauge(study), _agreement(study), _kappas(study), _drift(study)]


def _about(study: Material) -> Section:
    plan, first, last = study.plan, study.presses[0], study.presses[-1]
    facts = {
        "study": plan.study_id,
        "part": f"{first.part}/{first.position}",
        "sensor, gel": f"{first.serial}, {first.gel_id}",
        "bundle": first.bundle_id[:16],
        "threshold": _number(first.threshold),
        "pressed": f"{local_time(first.time_ns)} to {local_time(last.time_ns)}",
        "order": f"random, seed {plan.seed}",
        "planned": f"{len(plan.pieces)} pieces x {len(plan.operators)} operators x {plan.repeats} repeats",
        "analysed": f"{' x '.join(map(str, study.scores.shape))}",
    }
    return Section("Study", tuple(_gaps(study)), ("fact", "value"), tuple(facts.items()))


def _gaps(study: Material) -> Iterator[str]:
    if study.missing:
        yield (
            f"The study is not complete: {write_count(study.missing, 'press')} of the plan without a score. The "
            f"analysis is that of the largest table without gaps, which leaves out "
            f"{write_count(study.left_out, 'press')}."
        )
    if study.rejected:
        words = ", ".join(f"{name} {number}" for name, number in sorted(study.rejected.items()))
        yield f"Presses without a score, pressed again: {sum(study.rejected.values())} (by operator: {words})."
    if study.void:
        yield f"Presses that the operator repeated: {study.void}; they do not count and stay in the database."


def _gauge(study: Material) -> list[Section]:
    try:
        gauge = gauge_by_anova(study.scores)
    except ValueError as error:
        return [Section("Gauge R&R of the score", (f"There is none: {error}.",))]
    return [_components(gauge), _variance(gauge)]


_NAMES = {
    "EV": "repeatability (EV)",
    "AV": "operators (AV)",
    "INT": "operators x pieces (INT)",
    "GRR": "gauge R&R (GRR)",
    "PV": "pieces (PV)",
    "TV": "total (TV)",
}
_SURE = f"{CONFIDENCE:.0%}"


def _components(found: Gauge) -> Section:
    rows = tuple(
        (
            _NAMES[name],
            _number(sd.value),
            f"{_number(sd.low)} to {_number(sd.high)}",
            f"{percent.value:.1f}",
            f"{percent.low:.1f} to {percent.high:.1f}",
            f"{percent.value**2 / 100:.1f}",
        )
        for (name, sd), percent in zip(found.sd.items(), found.percent.values(), strict=True)
    )
    grr, ndc = found.percent["GRR"], found.ndc
    word = "acceptable for some uses" if grr.value <= 30 else "not acceptable"
    sentences = (
        f"%GRR is {grr.value:.1f} ({_SURE}: {grr.low:.1f} to {grr.high:.1f}): "
        f"{'acceptable' if grr.value < 10 else word}. "
        "AIAG: below 10 acceptable, up to 30 depending on the use, above 30 not acceptable.",
        f"Distinct categories (ndc): {ndc.value:g} ({_SURE}: {ndc.low:g} to {ndc.high:g}); AIAG asks for 5 or more.",
    )
    interval = f"{_SURE} interval"
    head = ("component", "standard deviation", interval, "% of TV", interval, "% of variance")
    return Section("Gauge R&R of the score, analysis of variance", sentences, head, rows)


def _variance(found: Gauge) -> Section:
    rows = tuple(
        (name, f"{ss:.6g}", str(df), f"{ms:.6g}", "" if f is None else f"{f:.3f}", _probability(p))
        for name, ss, df, ms, f, p in found.sources
    )
    p = next(source.p for source in found.sources if source.name == "interaction")
    word = "pooled with repeatability" if found.is_pooled else "kept"
    sentence = f"The interaction is {word}: its p is {p:.3f}, the limit is {POOLED_ABOVE:g}."
    return Section("Table of variance", (sentence,), ("source", "SS", "df", "MS", "F", "p"), rows)


def _agreement(study: Material) -> Section:
    words = ", ".join(f"{number} {word}" for word, number in _count_verdicts(study))
    rows = []
    for number, name in enumerate(study.operators):
        shares = count_shares(study.verdicts[:, number], study.known)
        errors = (_share(one)[0] for one in (shares.misses, shares.false_alarms))
        rows.append((name, *_share(shares.same), *_share(shares.effectiveness), *errors))
    both = count_shares(study.verdicts.reshape(len(study.pieces), -1), study.known)
    rows.append(("all operators", *_share(both.same), *_share(both.effectiveness), "", ""))
    sentences = (f"Verdicts: {words}.", _NOT_KNOWN if study.known is None else _KNOWN)
    head = ("operator", "agrees with itself", "95 %", "effectiveness", "95 %", "misses", "false alarms")
    return Section("Agreement of verdicts, by piece", sentences, head, tuple(rows))


def _count_verdicts(study: Material) -> list[tuple[str, int]]:
    return Counter(study.verdicts.ravel().tolist()).most_common()


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


def _kappas(study: Material) -> Section:
    by_operator = dict(zip(study.operators, study.verdicts.swapaxes(0, 1), strict=True))
    kappas = {
        f"{one} and {other} (Cohen)": cohen_kappa(by_operator[one], by_operator[other])
        for one, other in combinations(study.operators, 2)
    }
    if study.known is not None:
        for name, own in by_operator.items():
            truth = np.broadcast_to(np.array(study.known)[:, None], own.shape)
            kappas[f"{name} and the known verdict (Cohen)"] = cohen_kappa(own, truth)
    kappas["all decisions (Fleiss)"] = fleiss_kappa(study.verdicts.reshape(len(study.pieces), -1))
    sentences = ["AIAG: kappa above 0.75 is good agreement, below 0.40 poor."]
    if len(verdicts := _count_verdicts(study)) == 1:
        sentences.append(
            f"Every verdict is {verdicts[0][0]}, so agreement is all by chance and kappa is not defined: add pieces of "
            "the other kind."
        )
    head = ("between", "kappa", "standard error", "agreement", "by chance")
    rows = tuple((name, *_kappa(kappa)) for name, kappa in kappas.items())
    return Section("Kappa", tuple(sentences), head, rows)


def _kappa(found: Kappa) -> tuple[str, str, str, str]:
    shares = f"{found.observed:.1%}", f"{found.expected:.1%}"
    if found.value is None:
        return "not defined", "", *shares
    return f"{found.value:.3f}", f"{found.standard_error:.3f}", *shares


def _drift(study: Material) -> Section:
    presses, title = study.presses, "Drift while the study ran"
    trend = drift(
        [float(press.score or 0.0) for press in presses], [(press.piece, press.operator) for press in presses]
    )
    if trend is None:
        return Section(title, ("There are too few presses to test it.",))
    total, low, high = trend.total
    changed = (
        f"Each press wears the gel. Over {len(presses)} presses the score changed by {_number(total)} (95 %: "
        f"{_number(low)} to {_number(high)}), p {trend.p:.3f}; one score varies by {_number(trend.sd)} around "
        "that line."
    )
    if trend.p >= 0.05:
        return Section(title, (changed, "No drift is found beyond chance."))
    times = abs(total) / (float(np.std(study.scores)) or 1.0)
    return Section(
        title,
        (
            changed,
            f"The drift is real, and {times:.1f} times the standard deviation of all scores: it is in the "
            "repeatability above. Look at the gel, and at what else changed with time.",
        ),
    )


def _share(one: Share | None) -> tuple[str, str]:
    if one is None:
        return "", ""
    if one.limits is None:
        return "none of that kind", ""
    low, high = one.limits
    return f"{one.found}/{one.of} = {one.found / one.of:.1%}", f"{low:.1%} to {high:.1%}"


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
            parts += ["", markdown_table(section.head, section.rows).rstrip()]
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
