"""Checkpoints: a folder per step, written completely or not at all; the last good one is always kept.

Each file stays below 16 MB, so that a run can be carried between machines in pieces.
"""

import hashlib
import io
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from calibration.folders import write_whole
from calibration.training.train_config import TrainConfig
from edge.core.errors import ConfigError, GelgateError

__all__ = ["Checkpoint", "load", "save", "weights_sha256"]

_PARTS = ("weights", "first_moment", "second_moment")
_STATE = "state.json"
_FORMAT = 1

Tensors = dict[str, Tensor]


@dataclass(frozen=True)
class Checkpoint:
    """Everything that the next step needs."""

    recipe: TrainConfig
    step: int
    """How many are done. Random draws need no state: they depend on the step."""
    weights: Tensors
    first_moment: Tensors
    second_moment: Tensors
    before: tuple[dict[str, Any], ...] = ()
    """The runs whose weights this one started from, oldest first: `recipe` and `steps` of each."""

    @property
    def history(self) -> tuple[dict[str, Any], ...]:
        """All runs up to now, this one last."""
        return (*self.before, {"recipe": json.loads(self.recipe.to_json()), "steps": self.step})


def save(folder: Path, checkpoint: Checkpoint) -> Path:
    """Write `step_<n>` in the folder and then remove the older one.

    Errors: GelgateError when the disk refuses, naming the step that is still safe.
    """
    final = folder / f"step_{checkpoint.step:07d}"
    part = folder / f".part_{checkpoint.step:07d}"
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        hashes = {name: _write(part / f"{name}.pt", getattr(checkpoint, name)) for name in _PARTS}
        state = {
            "format": _FORMAT,
            "step": checkpoint.step,
            "recipe": json.loads(checkpoint.recipe.to_json()),
            "before": list(checkpoint.before),
            "sha256": hashes,
        }
        write_whole(part / _STATE, json.dumps(state, indent=2).encode())
        shutil.rmtree(final, ignore_errors=True)
        os.replace(part, final)
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        safe = latest(folder)
        kept = f"the checkpoint '{safe}' is complete" if safe else "there is no earlier checkpoint"
        raise GelgateError(
            f"the checkpoint of step {checkpoint.step} cannot be written: {error.strerror}; {kept}; "
            "free space and resume"
        ) from error
    for old in folder.glob("step_*"):
        if old != final:
            shutil.rmtree(old, ignore_errors=True)
    return final


def _write(path: Path, tensors: Tensors) -> str:
    buffer = io.BytesIO()
    torch.save({name: value.detach().cpu().contiguous() for name, value in tensors.items()}, buffer)
    write_whole(path, buffer.getvalue())
    return hashlib.sha256(buffer.getvalue()).hexdigest()


def latest(folder: Path) -> Path | None:
    """The newest complete checkpoint in a run's folder, or the folder itself when it is one."""
    if (folder / _STATE).is_file():
        return folder
    checkpoints = sorted(p for p in folder.glob("step_*") if (p / _STATE).is_file())
    return checkpoints[-1] if checkpoints else None


def load(folder: Path, recipe: TrainConfig | None = None) -> Checkpoint:
    """The newest checkpoint of a run. recipe: the settings to train with; None accepts any.

    Errors: ConfigError when there is none, it is damaged, or it was made with other settings.
    """
    at = latest(folder)
    if at is None:
        raise ConfigError(f"no checkpoint in '{folder}'; start without --resume")
    try:
        state = json.loads((at / _STATE).read_text())
        stored_recipe, hashes = TrainConfig.from_json(json.dumps(state["recipe"])), state["sha256"]
        parts = {name: _read(at / f"{name}.pt", hashes[name]) for name in _PARTS}
    except (OSError, KeyError, TypeError, json.JSONDecodeError) as error:
        raise ConfigError(
            f"the checkpoint '{at}' is damaged ({error}); resume from another or start again"
        ) from error
    if recipe is not None and stored_recipe != recipe:
        changes = "; ".join(recipe.differences(stored_recipe))
        raise ConfigError(
            f"the checkpoint '{at}' was made with other settings ({changes}); "
            "resume with the same ones or start a new run in another folder"
        )
    return Checkpoint(stored_recipe, int(state["step"]), **parts, before=tuple(state.get("before", ())))


def weights_sha256(folder: Path) -> str:
    """Return what names the weights of a run's newest checkpoint. Errors: ConfigError when there is none."""
    at = latest(folder)
    if at is None:
        raise ConfigError(f"no checkpoint in '{folder}' to start from; name the folder of a run")
    return hashlib.sha256((at / "weights.pt").read_bytes()).hexdigest()


def _read(path: Path, sha256: str) -> Tensors:
    data = path.read_bytes()
    if hashlib.sha256(data).hexdigest() != sha256:
        raise ConfigError(
            f"'{path}' differs from its checkpoint's record; resume from another or start again"
        )
    tensors: Tensors = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    return tensors
