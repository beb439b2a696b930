"""The features of a station: found by the entry points `gelgate.features`, and loaded where they are wanted."""

from collections.abc import Mapping

from pydantic import BaseModel, ValidationError

from edge import registry
from edge.config import Config
from edge.core.errors import ConfigError
from edge.core.suggest import suggestion
from edge.messaging.alarm_payload import list_alarms
from edge.press_stage import PressStage
from edge.validation_messages import sentences

__all__ = ["Features", "load_every_feature", "load_features", "read_options"]

Features = Mapping[str, type[PressStage]]


def load_features(config: Config) -> Features:
    """Load the features that are configured, and those of other packages, in the order in which a press goes through
    them. Others may refuse a press, so they come before the piece and the outputs, which show what was decided.

    Errors: ConfigError for a feature that cannot be loaded, that declares an alarm of another, or with wrong options.
    """
    ours, installed = config.features, registry.names("features")
    if missing := [name for name, is_wanted in ours.items() if is_wanted and name not in installed]:
        raise ConfigError(
            f"gelgate is installed without its features {', '.join(missing)}: its code is newer than its installation; "
            "install it again, as with `pip install -e .`"
        )
    others = [name for name in installed if name not in ours]
    before = list(ours).index("piece")
    names = [*list(ours)[:before], *others, *list(ours)[before:]]
    features = {name: _load(name) for name in names if ours.get(name, True)}
    list_alarms()
    for name in config.feature:
        if name not in others or features[name].Options is None:
            known = [one for one in others if features[one].Options is not None]
            raise ConfigError(
                f"'feature.{name}': no installed feature of another package takes options under this "
                f"name; {suggestion(name, known)}"
            )
    for name in others:
        read_options(name, features[name], config)
    return features


def read_options(name: str, feature: type[PressStage], config: Config) -> BaseModel | None:
    """Return the options of a feature; None where it takes none. Errors: ConfigError, a sentence for each fault."""
    if feature.Options is None:
        return None
    try:
        return feature.Options.model_validate(config.feature.get(name, {}))
    except ValidationError as error:
        raise ConfigError("; ".join(sentences(feature.Options, error, f"feature.{name}"))) from error


def load_every_feature() -> Features:
    """Load all that are installed, for the manual. Errors: as `load_features`."""
    return {name: _load(name) for name in registry.names("features")}


def _load(name: str) -> type[PressStage]:
    feature = registry.feature(name)
    if isinstance(feature, type) and issubclass(feature, PressStage):
        return feature
    raise ConfigError(
        f"the entry point '{name}' of gelgate.features is no class of PressStage; correct its package"
    )
