"""`gelgate bundle learn`: a bundle, its nominal presses and what people said at the station in, a new bundle out."""

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import typer

from calibration.fitting.command import make, refuse_existing
from calibration.fitting.fit import Fitted, fit_files
from calibration.fitting.fit_again import configure_again, read_again
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.learn import (
    MOST_NAMED,
    Comparison,
    ConfirmedPress,
    ConfirmedPresses,
    join_pieces,
    judge_presses,
    leave_out_places,
    read_confirmed,
    score_refused,
    write_picture,
    write_pictures,
)
from calibration.fitting.options import GelId, LeaveOut, NoContact, Output, Overwrite, Threads
from calibration.fitting.presses.nominal_presses import NominalPresses, read_presses
from calibration.fitting.presses.sources import check_present
from calibration.fitting.regions.drawing import draw_again
from calibration.fitting.teach import BEARABLE, Lesson, Remedy, lower_limit, lower_place, name_alike
from calibration.progress import Report
from edge.cli.arguments import add_argument, add_option, flatten
from edge.cli.options import CONFIG, ConfigOption, DatabaseOption, database_path
from edge.core.errors import FitError, StoreError
from edge.core.part_position import PartPosition
from edge.core.printable import write_count
from edge.model.bundle import Bundle
from edge.model.manifest_facts import share_found
from edge.model.scorer import Scorer
from edge.store.person_verdicts import ask_again
from edge.store.press_store import Store

__all__ = ["WAY_ON", "learn", "warn_of_lost"]

WAY_ON: Final = (
    "next: name it under `shadows` in [inspection], and reload; it is scored beside the one in use"
)

# Of 48 rendered damages two fits of the same part find some more or fewer by chance.
_FEWER = 0.9


@dataclass(frozen=True)
class LearnArguments:
    """What the command line says."""

    output: Output
    bundle: Path = add_argument(..., "The bundle in use.")
    sources: list[Path] = add_argument(..., "Its nominal presses, as for `fit`.", metavar="SOURCE...")
    config: ConfigOption = CONFIG
    database: DatabaseOption = None
    alpha: float | None = add_option(
        None, "False-alarm rate of the threshold; default: that of the bundle.", show_default=False
    )
    no_contact: NoContact = None
    leave_out: LeaveOut = None
    gel: GelId = None
    threads: Threads = 2
    overwrite: Overwrite = False


@flatten
def learn(given: LearnArguments) -> None:
    """Learn from what people said at the station.

    Presses that people call good are learnt beside the nominal ones, with the detector and the backbone of the bundle.
    Drawn regions stay. Damage that was found before and that the new bundle passes is taught, as by `teach`. The bundle
    is not written where that costs too much, or where it fails more good presses. Try it as a shadow
    (docs/operations.md).
    """
    refuse_existing(given.output, given.overwrite)
    check_present(given.sources)
    old = Bundle.load(given.bundle)
    manifest, database = old.manifest, database_path(given.config, given.database)
    confirmed = _read_words(database, PartPosition(manifest.part, manifest.position), old)
    config = configure_again(old, given.alpha, given.threads, given.gel)
    presses, learnt = _read_presses(given, old, confirmed)
    _warn_without_gel(old, presses)
    warn_of_lost(old)
    typer.echo(f"{write_count(len(presses), 'nominal press')}, {len(learnt)} of them from the station")

    # Of a gel on which the bundle is not proven the first presses all stand apart, and have to be learnt.
    doubtful = [k for k in learnt if Path(presses.names[k]).stem not in confirmed.on_new_gel]

    def fit_and_check(created: str, report: Report) -> Fitted:
        judge = partial(
            judge_presses, presses=confirmed, database=database, threads=given.threads, report=report
        )
        before = judge(old)

        def compare(fitted: Fitted) -> Comparison:
            comparison = Comparison(confirmed, before, judge(fitted.bundle()))
            typer.echo(f"{comparison.describe()}; {comparison.changes()}")
            return comparison

        fitted, kept = fit_files(presses, config, created=created, report=report), presses
        apart = [k for k in doubtful if presses.names[k] in fitted.apart]
        if apart and _finds_fewer(old.manifest.facts, fitted.manifest.facts):
            others = presses.choose([k for k in range(len(presses)) if k not in apart])
            without = fit_files(others, config, created=created, report=report)
            if _finds_fewer(without.manifest.facts, fitted.manifest.facts):
                fitted, kept = without, others
                _leave_out_apart([Path(presses.names[k]).stem for k in apart], database)
        fitted = draw_again(old, fitted, kept, config, created)
        fitted, comparison = _teach_lost(fitted, compare(fitted), kept, config, created, compare)
        _warn_of_fewer_found(old.manifest.facts, fitted.manifest.facts)
        try:
            comparison.check()
        except FitError as error:
            alike = _name_alike(old, comparison, presses.choose(learnt), given.threads)
            raise _ask_again(FitError("; ".join([str(error), *alike])), comparison, database) from None
        return fitted

    make(fit_and_check, given.output, given.overwrite)
    typer.echo(WAY_ON)


def _read_presses(
    given: LearnArguments, old: Bundle, confirmed: ConfirmedPresses
) -> tuple[NominalPresses, list[int]]:
    """Read the nominal presses and those that people call good; returns the numbers of the latter too."""
    with tempfile.TemporaryDirectory() as folder:
        pictures = Path(folder) / "confirmed"
        presses = read_again(
            old,
            given.sources,
            more=write_pictures(confirmed.good, pictures),
            no_contact=given.no_contact,
            leave_out=given.leave_out or (),
        )
    unjudged = {press.press.press_id: press.unjudged for press in confirmed.good}
    presses = leave_out_places(join_pieces(presses, confirmed.good), unjudged)
    return presses, [k for k, name in enumerate(presses.names) if name.startswith(f"{pictures.name}/")]


def _teach_lost(
    fitted: Fitted,
    comparison: Comparison,
    presses: NominalPresses,
    config: FitConfig,
    created: str,
    compare: Callable[[Fitted], Comparison],
) -> tuple[Fitted, Comparison]:
    """Teach the new bundle the damage that it loses, by the limit of all places or of its own, whichever costs less.

    Returns the same bundle where it loses none, and where that cannot be or costs too much, which is said. What costs
    much is taken all the same where the old bundle fails clearly more of the station's presses.
    """
    if not comparison.lost:
        return fitted, comparison
    new = fitted.bundle()
    tried: list[Remedy | str] = ["the new bundle finds it in the picture"]
    try:
        lesson = Lesson(new, _read_pictures(comparison.lost, new), presses, config, created)
        if lesson.missed:
            tried = [lower_limit(lesson), lower_place(lesson)]
    except FitError as error:
        tried = [str(error)]
    found = [one for one in tried if not isinstance(one, str) and all(one.is_found)]
    if not found:
        words = (one if isinstance(one, str) else one.describe() for one in tried)
        typer.echo(f"what the new bundle loses is not taught: {'; '.join(words)}")
        return fitted, comparison
    remedy = min(found, key=lambda one: (one.rate, one.alarms))
    taught = compare(remedy.fitted)
    is_worth_it = remedy.rate <= BEARABLE or taught.is_quieter
    typer.echo(
        f"what the new bundle loses {'is taught' if is_worth_it else 'costs too much'}: {remedy.describe()}"
    )
    return (remedy.fitted, taught) if is_worth_it else (fitted, comparison)


def _read_pictures(presses: Sequence[ConfirmedPress], bundle: Bundle) -> NominalPresses:
    """Read archived presses as pictures of the region, with their ids for names."""
    with tempfile.TemporaryDirectory() as folder:
        files = [write_picture(press.press, press.frame, Path(folder)) for press in presses]
        return _with_stems(read_presses(files, bundle.profile, bundle.region))


def _with_stems(presses: NominalPresses) -> NominalPresses:
    return replace(presses, names=tuple(Path(name).stem for name in presses.names))


def _name_alike(old: Bundle, comparison: Comparison, good: NominalPresses, threads: int) -> list[str]:
    """Say of each lost damage which of the learnt presses resembles it most: one of the two words may be wrong."""
    lost = comparison.lost[:MOST_NAMED]
    if not lost or not len(good):
        return []
    return name_alike(old, _read_pictures(lost, old), _with_stems(good), threads)


def _ask_again(error: FitError, comparison: Comparison, database: Path) -> FitError:
    """Have the station ask once more about the presses that stand against the new bundle; return the error that says
    so."""
    sentence = _ask_about(
        [alarm.press.press_id for alarm in (*comparison.lost, *comparison.new_alarms)], database
    )
    return FitError(f"{error}; {sentence}") if sentence else error


def _leave_out_apart(press_ids: Sequence[str], database: Path) -> None:
    """Say that good presses are not learnt, and have the station ask about each once more."""
    warning = (
        f"warning: left out: {', '.join(press_ids)}: called good, but far from all others, and with it the new bundle "
        "finds less of the damage that a fit renders; if such parts are good, give a picture of one among the nominal "
        "presses"
    )
    typer.echo("; ".join(filter(None, [warning, _ask_about(press_ids, database)])), err=True)


def _ask_about(press_ids: Sequence[str], database: Path) -> str:
    """Have the station ask about presses once more, and return what to say of it. A copy of a station's database is
    asked too, where it can be written."""
    try:
        with Store(database) as store:
            return ask_again(store, press_ids, "gelgate bundle learn", time.time_ns())
    except StoreError as fault:
        return f"the station cannot be told to ask about them again: {fault}"


def _read_words(database: Path, part: PartPosition, old: Bundle) -> ConfirmedPresses:
    """Read what people said of a part, and say what of it is left out. Errors: FitError where nothing can be learnt."""
    confirmed = read_confirmed(database, part, old.digest, partial(score_refused, Scorer(old)))
    for sentence in confirmed.left_out:
        typer.echo(f"warning: left out: {sentence}", err=True)
    words = ", ".join(f"{number} {word}" for word, number in sorted(confirmed.words.items())) or "nothing"
    typer.echo(f"people said of {part}: {words}")
    if not confirmed.good:
        raise FitError(
            f"no press of {part} that people call good can be learnt; say what presses were, on the page or with "
            "`confirm_press`"
        )
    confirmed.check_new_gel()
    return confirmed


def warn_of_lost(old: Bundle) -> None:
    """Warn where the old bundle was taught damage, which the new one has to be taught again."""
    taught = [name for one in old.manifest.facts.get("taught", ()) for name in one["presses"]]
    if taught:
        typer.echo(
            f"warning: the old bundle was taught {', '.join(taught)}; teach the new one again (`gelgate bundle teach`)",
            err=True,
        )


def _finds_fewer(old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    """Tell whether a bundle finds clearly less of the damage that a fit renders. old, new: facts of manifests."""
    before, now = share_found(old), share_found(new)
    return before is not None and now is not None and now < _FEWER * before


def _warn_of_fewer_found(old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Warn where the new bundle finds less of the damage that a fit renders. old, new: the facts of their manifests."""
    before, now = share_found(old), share_found(new)
    if before is not None and now is not None and _finds_fewer(old, new):
        typer.echo(
            f"warning: of the small damage that a fit renders the new bundle finds {now:.0%}, the old one "
            f"{before:.0%}: the learnt presses raise its limit; press damaged parts before it takes over, and teach "
            "it those that pass (`gelgate bundle teach`)",
            err=True,
        )


def _warn_without_gel(old: Bundle, presses: NominalPresses) -> None:
    """Warn where the old bundle knew the free gel, and the new one will not."""
    if old.free_view is not None and presses.free_view is None:
        typer.echo(
            "warning: the old bundle knew the free gel, and these sources do not show it: less damage may be found; "
            "give pictures of it with --no-contact",
            err=True,
        )
