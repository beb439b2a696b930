"""Which method and trunk a fit uses: those whose banks see most of small damage put into the station's own presses.

Each pair is judged out of fold, as the limit of a fit is found. No label is used. docs/detectors.md compares the
choice with the truth, part by part.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from calibration.fitting.candidates import Candidates
from calibration.fitting.damage_seen import DamageJudge, Seen, TrunkBench
from calibration.fitting.fit_config import FitConfig
from calibration.fitting.presses.nominal_presses import MIN_PRESSES, NominalPresses
from calibration.fitting.trunks import open_trunk
from calibration.progress import Report
from calibration.threads import one_blas_thread
from edge import registry
from edge.core.errors import ConfigError, FitError
from edge.model.manifest_facts import BACKBONE_CHOICE, METHOD_CHOICE

__all__ = ["Comparison", "choose_detection"]


Pair = tuple[str, str]
"""A method and a trunk, by their names among the candidates."""


@one_blas_thread()
def choose_detection(
    presses: NominalPresses,
    config: FitConfig,
    candidates: Candidates,
    report: Report = lambda stage, fraction: None,
) -> FitConfig:
    """The configuration with the method and the trunk that separate most, and why.

    config: with the usual ones, which stay where nothing can be compared. Errors: FitError where nothing can be
    compared and several methods are candidates, or where none takes the presses.
    """
    if why := _hindrance(presses, config):
        return _usual(config, candidates, why)
    judge = DamageJudge(presses, config)
    if not judge.damaged:
        return _usual(config, candidates, "no damage shows in the presses")
    compared = Comparison(config, candidates)
    compared.run(judge, report)
    return compared.chosen()


def _hindrance(presses: NominalPresses, config: FitConfig) -> str:
    """Why nothing can be compared; empty where it can."""
    if config.mode == "paper":
        return "the published methods have no choice"
    if presses.no_contact is None:
        return "damage is rendered with a picture of the free gel; give one with --no-contact"
    if len(presses) < MIN_PRESSES:
        return f"of fewer than {MIN_PRESSES} presses nothing can be held out"
    return ""


def _usual(config: FitConfig, candidates: Candidates, why: str) -> FitConfig:
    """Errors: FitError where several methods are candidates."""
    if len(candidates.methods) > 1:
        raise FitError(
            f"no method can be chosen: {why}; name one with --method, such as {candidates.methods[0]}"
        )
    usual = config.trunk.id
    kept = {"chosen": usual, "why": f"{usual}, without a comparison: {why}", "found": {}}
    return replace(config, choice_facts={BACKBONE_CHOICE: kept})


class Comparison:
    """What every pair sees of the damage. seen: of those that could be tried."""

    def __init__(self, config: FitConfig, candidates: Candidates) -> None:
        self._config, self._candidates = config, candidates
        self._detectors = {name: registry.detector(name) for name in candidates.methods}
        # Each tap once, of all methods.
        self._taps = tuple(dict.fromkeys(tap for name in self._detectors for tap in self._read_by(name)))
        self.seen: dict[Pair, Seen] = {}
        self._errors: dict[Pair, ConfigError | FitError] = {}

    def _read_by(self, method: str) -> tuple[str, ...]:
        detector, config = self._detectors[method], self._config
        return detector.taps(detector.parameters(config.mode, **config.overrides))

    def run(self, judge: DamageJudge, report: Report) -> None:
        """On one trunk after the other, all methods on the same features. Errors: FitError where no pair can be
        tried."""
        benches = self._benches()
        for number, (trunk, bench) in enumerate(benches.items()):
            report("choice", number / len(benches))
            self._run_on(judge, bench, trunk)
        if benches:
            report("choice", 1.0)
        if not self.seen:
            raise next(iter(self._errors.values()))

    def _benches(self) -> dict[str, TrunkBench]:
        """The trunks on which some method can be tried; what cannot is known before the work."""
        found: dict[str, TrunkBench] = {}
        for trunk in self._candidates.trunks:
            try:
                bench = TrunkBench(open_trunk(trunk, self._taps), self._taps, self._config)
            except (ConfigError, FitError) as error:
                self._errors |= {(method, trunk): error for method in self._detectors}
                continue
            for method, detector in self._detectors.items():
                try:
                    bench.learner(detector)
                except FitError as error:
                    self._errors[method, trunk] = error
                else:
                    found[trunk] = bench
        return found

    def _run_on(self, judge: DamageJudge, bench: TrunkBench, trunk: str) -> None:
        for method, detector in self._detectors.items():
            if (method, trunk) in self._errors:
                continue
            try:
                self.seen[method, trunk] = judge.seen(detector, bench)
            except FitError as error:
                self._errors[method, trunk] = error

    def chosen(self) -> FitConfig:
        """The configuration with the pair that sees most, and why for the manifest."""
        method, trunk = max(self.seen, key=lambda pair: self.seen[pair].mean)
        detector, facts = self._detectors[method], {}
        opened = open_trunk(trunk, self._read_by(method))
        if len(self._candidates.methods) > 1:
            facts[METHOD_CHOICE] = {"chosen": method, "why": self._why_method(method), "found": self._found()}
        if len(self._candidates.trunks) > 1:
            found = {name: dict(kinds) for name, kinds in self._found()[method].items()}
            facts[BACKBONE_CHOICE] = {"chosen": trunk, "why": self._why_trunk(method, trunk), "found": found}
        return replace(self._config, detector=detector, trunk=opened, choice_facts=facts)

    def _found(self) -> dict[str, dict[str, dict[str, float]]]:
        """By method, trunk and kind of damage. A trunk that is a file is its name alone."""
        found: dict[str, dict[str, dict[str, float]]] = {}
        for (method, trunk), seen in self.seen.items():
            of = {kind: round(one, 4) for kind, one in seen.found.items()}
            found.setdefault(method, {})[Path(trunk).name] = of
        return found

    def _why_method(self, chosen: str) -> str:
        """Each method on the trunk on which it sees most."""
        best: dict[str, Seen] = {}
        for (method, _), seen in self.seen.items():
            best[method] = max(best.get(method, seen), seen, key=lambda one: one.mean)
        said = (
            f"{name} {seen.mean:.3f}, {seen.press_ms:.1f} ms a press{' with registration' * seen.is_registered}"
            for name, seen in best.items()
        )
        left_out = {method: error for (method, _), error in self._errors.items() if method not in best}
        return self._sentence(chosen, "; ".join(said), left_out)

    def _why_trunk(self, method: str, chosen: str) -> str:
        on = (f"{trunk} {seen.mean:.3f}" for (of, trunk), seen in self.seen.items() if of == method)
        left_out = {trunk: error for (of, trunk), error in self._errors.items() if of == method}
        return self._sentence(chosen, ", ".join(on), left_out)

    def _sentence(self, chosen: str, said: str, left_out: Mapping[str, Exception]) -> str:
        kinds = " and ".join(next(iter(self.seen.values())).found)
        why = (
            f"{chosen}: of {kinds} in the nominal presses its banks see most ({said}; mean of image AUROC and AU-PRO "
            "up to 1 %, out of fold)"
        )
        return "; ".join([why, *(f"{name} was not tried: {error}" for name, error in left_out.items())])
