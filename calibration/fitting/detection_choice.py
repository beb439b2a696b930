"""Which method and trunk a fit uses: those whose banks see most of small damage put into the station's own presses.

Each pair is judged out of fold, as the limit of a fit is found. No label is used. docs/detectors.md compares the
choice with the truth, part by part.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from calibration.fitting.candidates import Candidates
from calibration.fitting.damage_seen import DamageJudge, Separation
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
    """Choose the method and the trunk that separate most, and say why.

    config: with the usual ones, which stay where nothing can be compared. Errors: FitError where nothing can be
    compared and several methods are candidates, or where none takes the presses.
    """
    if why := _find_hindrance(presses, config):
        return _keep_usual(config, candidates, why)
    judge = DamageJudge(presses, config)
    if not judge.damaged:
        return _keep_usual(config, candidates, "no damage shows in the presses")
    compared = Comparison(config, candidates)
    compared.run(judge, report)
    return compared.choose()


def _find_hindrance(presses: NominalPresses, config: FitConfig) -> str:
    """Say why nothing can be compared; empty where it can."""
    if config.mode == "paper":
        return "the published methods have no choice"
    if presses.no_contact is None:
        return "damage is rendered with a picture of the free gel; give one with --no-contact"
    if len(presses) < MIN_PRESSES:
        return f"of fewer than {MIN_PRESSES} presses nothing can be held out"
    return ""


def _keep_usual(config: FitConfig, candidates: Candidates, why: str) -> FitConfig:
    """Keep the usual trunk, and say why. Errors: FitError where several methods are candidates."""
    if len(candidates.methods) > 1:
        raise FitError(
            f"no method can be chosen: {why}; name one with --method, such as {candidates.methods[0]}"
        )
    usual = config.trunk.id
    kept = {"chosen": usual, "why": f"{usual}, without a comparison: {why}", "found": {}}
    return replace(config, choice_facts={BACKBONE_CHOICE: kept})


class Comparison:
    """What every pair sees of the damage; of those that cannot be tried, why."""

    def __init__(self, config: FitConfig, candidates: Candidates) -> None:
        self._config, self._candidates = config, candidates
        self._detectors = {name: registry.detector(name) for name in candidates.methods}
        # Each tap once, of all methods.
        self._taps = tuple(dict.fromkeys(tap for name in self._detectors for tap in self._taps_of(name)))
        self.separations: dict[Pair, Separation] = {}
        self._errors: dict[Pair, ConfigError | FitError] = {}

    def _taps_of(self, method: str) -> tuple[str, ...]:
        detector, config = self._detectors[method], self._config
        return detector.taps(detector.parameters(config.mode, **config.overrides))

    def run(self, judge: DamageJudge, report: Report) -> None:
        """Judge on one trunk after the other, all methods on the same features. Errors: FitError where no pair can be
        tried."""
        for number, trunk in enumerate(self._candidates.trunks):
            report("choice", number / len(self._candidates.trunks))
            seen: Mapping[str, Separation | ConfigError | FitError]
            try:
                seen = judge.judge(open_trunk(trunk, self._taps), self._taps, self._detectors)
            except (ConfigError, FitError) as error:
                seen = dict.fromkeys(self._detectors, error)
            for method, found in seen.items():
                if isinstance(found, Separation):
                    self.separations[method, trunk] = found
                else:
                    self._errors[method, trunk] = found
        report("choice", 1.0)
        if not self.separations:
            raise next(iter(self._errors.values()))

    def choose(self) -> FitConfig:
        """Return the configuration with the pair that sees most, and why for the manifest."""
        method, trunk = max(self.separations, key=lambda pair: self.separations[pair].mean)
        facts, shares = {}, self._shares()
        if len(self._candidates.methods) > 1:
            facts[METHOD_CHOICE] = {"chosen": method, "why": self._say_why_method(method), "found": shares}
        if len(self._candidates.trunks) > 1:
            why = self._say_why_trunk(method, trunk)
            facts[BACKBONE_CHOICE] = {"chosen": trunk, "why": why, "found": shares[method]}
        opened = open_trunk(trunk, self._taps_of(method))
        return replace(self._config, detector=self._detectors[method], trunk=opened, choice_facts=facts)

    def _shares(self) -> dict[str, dict[str, dict[str, float]]]:
        """Return what is seen by method, trunk and kind of damage. A trunk that is a file is its name alone."""
        shares: dict[str, dict[str, dict[str, float]]] = {}
        for (method, trunk), one in self.separations.items():
            of = {kind: round(share, 4) for kind, share in one.by_kind.items()}
            shares.setdefault(method, {})[Path(trunk).name] = of
        return shares

    def _say_why_method(self, method: str) -> str:
        """Compare the methods, each on the trunk on which it sees most."""
        best: dict[str, Separation] = {}
        for (name, _), one in self.separations.items():
            best[name] = max(best.get(name, one), one, key=lambda each: each.mean)
        said = (
            f"{name} {one.mean:.3f}, {one.press_ms:.1f} ms a press{' with registration' * one.is_registered}"
            for name, one in best.items()
        )
        left_out = {name: error for (name, _), error in self._errors.items() if name not in best}
        return self._say_why(method, "; ".join(said), left_out)

    def _say_why_trunk(self, method: str, trunk: str) -> str:
        on = (f"{name} {one.mean:.3f}" for (of, name), one in self.separations.items() if of == method)
        left_out = {name: error for (of, name), error in self._errors.items() if of == method}
        return self._say_why(trunk, ", ".join(on), left_out)

    def _say_why(self, name: str, said: str, left_out: Mapping[str, Exception]) -> str:
        kinds = " and ".join(next(iter(self.separations.values())).by_kind)
        why = (
            f"{name}: of {kinds} in the nominal presses its banks see most ({said}; mean of image AUROC and AU-PRO "
            "up to 1 %, out of fold)"
        )
        return "; ".join([why, *(f"{other} was not tried: {error}" for other, error in left_out.items())])
