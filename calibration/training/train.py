"""The training loop behind `gelgate lab train-backbone`.

A step depends only on the recipe and its number. So a resumed run equals an uninterrupted one, bit for bit on a CPU,
within the runtime's own differences on a GPU.
"""

import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from calibration.simulator.workers import in_processes
from calibration.training import checkpoint as checkpoints
from calibration.training.checkpoint import Checkpoint
from calibration.training.losses import (
    Losses,
    cell_distances,
    find_changed_cells,
    losses,
    separation,
    window_cells,
)
from calibration.training.network import TrunkNetwork, heads
from calibration.training.train_config import STAGES, TrainConfig
from calibration.training.training_pairs import Pairs, draw_pairs
from edge.core.errors import ConfigError, GelgateError

__all__ = ["TrainingRun", "train"]

_VALIDATION_BATCHES = 4
_VALIDATION_PAIRS = 32
_LOG = "log.jsonl"
_LOSS_NAMES = tuple(f.name for f in fields(Losses))


@dataclass(frozen=True)
class TrainingRun:
    """How a run is executed; it does not change the result.

    save_every, log_every, validate_every: steps.
    """

    folder: Path
    """For checkpoints, log and figure."""
    resume: Path | None = None
    """A run to continue, None to start."""
    minutes: float = 0.0
    """Stop and save after this time, 0 for never."""
    save_every: int = 500
    log_every: int = 20
    validate_every: int = 500
    device: str = "auto"
    threads: int = 0
    """Threads of the CPU, 0 for torch's choice; on shared cores 1 is several times faster than 2."""
    is_drawn_ahead: bool = False
    """Draw in a second process, next to a GPU in one per other core."""
    start: Path | None = None
    """Another run whose weights the recipe starts from."""


def learning_rate(recipe: TrainConfig, step: int) -> float:
    """Return the rate: a cosine rise from a 25th of the peak over the warm-up, then a cosine fall to almost nothing."""
    done = step / max(recipe.steps, 1)
    if done < recipe.warm_up:
        return recipe.max_rate * (0.04 + 0.96 * 0.5 * (1 - math.cos(math.pi * done / recipe.warm_up)))
    left = (done - recipe.warm_up) / (1 - recipe.warm_up)
    return recipe.max_rate * (1e-4 + (1 - 1e-4) * 0.5 * (1 + math.cos(math.pi * left)))


class _Learner:
    """Network, heads and optimiser of one run."""

    def __init__(self, recipe: TrainConfig, device: torch.device) -> None:
        self.recipe, self.device = recipe, device
        torch.manual_seed(recipe.seed)
        self.trunk = TrunkNetwork().to(device)
        self.heads = heads().to(device)
        self.trunk = self.trunk.to(memory_format=torch.channels_last)
        if device.type == "cuda":
            torch.backends.cudnn.benchmark = True
        self.model = nn.ModuleDict({"trunk": self.trunk, "heads": self.heads})
        decayed = [p for p in self.model.parameters() if p.ndim > 1]
        plain = [p for p in self.model.parameters() if p.ndim <= 1]
        groups = [{"params": decayed}, {"params": plain, "weight_decay": 0.0}]
        self.optimiser = torch.optim.AdamW(groups, lr=recipe.max_rate, weight_decay=recipe.weight_decay)
        self.step = 0
        self.before: tuple[dict[str, Any], ...] = ()

    def learn(self, batch: Pairs) -> Losses:
        """Take one step on its batch."""
        recipe = self.recipe
        self.model.train()
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(recipe, self.step)
        step_losses = losses(self._maps(batch), self.heads, batch, recipe)
        self.optimiser.zero_grad(set_to_none=True)
        step_losses.total(recipe).backward()
        nn.utils.clip_grad_norm_(self.model.parameters(), 5.0)
        self.optimiser.step()
        self.step += 1
        return step_losses

    def _maps(self, batch: Pairs) -> list[Tensor]:
        frames = batch.frames.contiguous(memory_format=torch.channels_last)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.recipe.precision == "bfloat16"):
            maps: list[Tensor] = self.trunk(frames)
        return maps

    def validate(self) -> dict[str, float]:
        """Per stage, the share of changed cells above 99 % of unchanged ones, on pairs that training never draws."""
        self.model.eval()
        distances: dict[str, list[tuple[Tensor, Tensor, Tensor]]] = {stage: [] for stage in STAGES}
        with torch.no_grad():
            for number in range(_VALIDATION_BATCHES):
                pairs, side = min(_VALIDATION_PAIRS, self.recipe.pairs), self.recipe.side
                batch = draw_pairs(0, "validate", number, pairs=pairs, side=side, high_resolution=0.0)
                batch = batch.to(self.device)
                for stage, features in zip(STAGES, self._maps(batch), strict=True):
                    stride = self.recipe.side // features.shape[-1]
                    cells = find_changed_cells(batch.change_mm, stride, self.recipe)
                    reach = window_cells(self.recipe.window_mm, stride, batch.spacing)
                    distance = cell_distances(features, reach)
                    distances[stage].append((distance.flatten(), cells[0].flatten(), cells[1].flatten()))
        joined = {
            s: [torch.cat(column) for column in zip(*rows, strict=True)] for s, rows in distances.items()
        }
        return {f"recall_fpr01_{stage}": separation(*columns) for stage, columns in joined.items()}

    def checkpoint(self) -> Checkpoint:
        names = {parameter: name for name, parameter in self.model.named_parameters()}
        moments = self.optimiser.state
        return Checkpoint(
            self.recipe,
            self.step,
            dict(self.model.state_dict()),
            {names[p]: moments[p]["exp_avg"] for p in names if p in moments},
            {names[p]: moments[p]["exp_avg_sq"] for p in names if p in moments},
            self.before,
        )

    def begin_with(self, saved: Checkpoint) -> None:
        """Take over only the weights of another run. Errors: ConfigError for weights of another network."""
        try:
            self.model.load_state_dict(saved.weights)
        except RuntimeError as error:
            raise ConfigError(f"the checkpoint holds another network: {error!s:.200}") from error
        self.before = saved.history

    def restore(self, saved: Checkpoint) -> None:
        """Continue from a checkpoint, whose moments are those of its weights. Errors: as `begin_with`."""
        self.begin_with(saved)
        for name, parameter in self.model.named_parameters():
            self.optimiser.state[parameter] = {
                "step": torch.tensor(float(saved.step)),
                "exp_avg": saved.first_moment[name].to(parameter),
                "exp_avg_sq": saved.second_moment[name].to(parameter),
            }
        self.step, self.before = saved.step, saved.before


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def train(
    recipe: TrainConfig,
    run: TrainingRun,
    say: Callable[[str], None] = _say,
    advance: Callable[[int], None] = lambda _: None,
) -> Path:
    """Train to the recipe's last step or to the run's time limit; the folder of the last checkpoint.

    say: takes a line for people. advance: takes the number of steps done, after each.
    Errors: ConfigError for a resume with other settings or a folder in use, GelgateError for a full disk.
    """
    device = _device(run.device)
    if run.threads:
        torch.set_num_threads(run.threads)
    learner = _Learner(recipe, device)
    log = _start(learner, run)
    started, since, since_step = time.monotonic(), time.monotonic(), learner.step
    say(f"{device}, recipe {recipe.fingerprint}, step {learner.step} of {recipe.steps}")
    at = checkpoints.latest(run.folder) or run.folder
    workers = 1 if device.type == "cpu" else max(1, (os.cpu_count() or 1) - 1)
    batches = (
        _draw_ahead(recipe, learner.step, workers)
        if run.is_drawn_ahead
        else (_draw_step(recipe, step) for step in range(learner.step, recipe.steps))
    )
    with _stop_asked() as is_stopped, closing(batches):
        for batch in batches:
            step_losses = learner.learn(batch.to(device))
            advance(learner.step)
            is_late = is_stopped() or (run.minutes > 0 and time.monotonic() - started > 60 * run.minutes)
            is_last = learner.step == recipe.steps or is_late
            if learner.step % run.log_every == 0 or is_last:
                entry = _entry(learner, step_losses, (learner.step - since_step) / (time.monotonic() - since))
                if learner.step % run.validate_every == 0 or is_last:
                    entry |= learner.validate()
                log.append(entry)
                say(_line(entry, recipe))
                since, since_step = time.monotonic(), learner.step
            if learner.step % run.save_every == 0 or is_last:
                at = _save(learner, run, log)
            if is_last:
                break
        if is_stopped():
            say(f"stopped at step {learner.step}; continue with --resume {run.folder}")
            raise KeyboardInterrupt
    say(f"step {learner.step} of {recipe.steps}, checkpoint {at}")
    return at


def _draw_step(recipe: TrainConfig, step: int) -> Pairs:
    side, fine = recipe.side, recipe.high_resolution
    return draw_pairs(recipe.seed, "train", step, pairs=recipe.pairs, side=side, high_resolution=fine)


def _draw_ahead(recipe: TrainConfig, first: int, workers: int) -> Generator[Pairs, None, None]:
    """Draw in other processes while the network learns from the previous batch; the bytes are the same.

    Each process uses one thread: on shared cores, two threads of one process wait for each other by spinning, and a
    step takes four times as long (measured on two cores). Errors: GelgateError when such a process has died.
    """
    try:
        yield from in_processes(partial(_draw_step, recipe), range(first, recipe.steps), workers)
    except BrokenProcessPool as error:
        raise GelgateError(
            f"the drawing process ended: {error}; resume, with --no-ahead if it happens again"
        ) from error


@contextmanager
def _stop_asked() -> Iterator[Callable[[], bool]]:
    """Lets a step finish when the run is interrupted: half a step cannot be resumed."""
    asked: list[int] = []
    before = {
        kind: signal.signal(kind, lambda *_: asked.append(1)) for kind in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield lambda: bool(asked)
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


def _device(name: str) -> torch.device:
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda: torch sees no GPU here; use cpu or auto")
    return torch.device(name)


def _start(learner: _Learner, run: TrainingRun) -> list[dict[str, Any]]:
    """Restore the state if `resume` or `start` is set; returns the log of the earlier steps."""
    if run.resume is None:
        if checkpoints.latest(run.folder) is not None:
            raise ConfigError(
                f"'{run.folder}' already holds a run; add --resume {run.folder} or choose another folder"
            )
        named = "" if run.start is None else checkpoints.weights_sha256(run.start)
        if named != learner.recipe.start:
            raise ConfigError(
                f"the recipe starts from the weights '{learner.recipe.start[:12]}', and --start names "
                f"'{named[:12]}'; name the folder of the run that the recipe continues"
            )
        if run.start is not None:
            learner.begin_with(checkpoints.load(run.start))
        return []
    saved = checkpoints.load(run.resume, learner.recipe)
    learner.restore(saved)
    lines = run.resume / _LOG
    log = [json.loads(line) for line in lines.read_text().splitlines()] if lines.is_file() else []
    return [entry for entry in log if entry["step"] <= saved.step]


def _save(learner: _Learner, run: TrainingRun, log: list[dict[str, Any]]) -> Path:
    at = checkpoints.save(run.folder, learner.checkpoint())
    try:
        (run.folder / _LOG).write_text("".join(json.dumps(entry) + "\n" for entry in log))
        _draw_losses(run.folder / "losses.png", log)
    except OSError as error:
        raise GelgateError(
            f"the log in '{run.folder}' cannot be written: {error.strerror}; '{at}' is complete"
        ) from error
    return at


def _draw_losses(path: Path, log: list[dict[str, Any]]) -> None:
    """Draw each loss over the steps, on a logarithmic scale."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.2))
    axes = figure.subplots()
    for name in _LOSS_NAMES:
        axes.plot([entry["step"] for entry in log], [entry[name] for entry in log], label=name)
    axes.set(xlabel="step", yscale="log")
    axes.legend()
    figure.savefig(path)


def _entry(learner: _Learner, found: Losses, steps_per_second: float) -> dict[str, Any]:
    entry: dict[str, Any] = {"step": learner.step, "rate": learning_rate(learner.recipe, learner.step - 1)}
    entry |= {name: getattr(found, name).item() for name in _LOSS_NAMES}
    entry["frames_per_second"] = round(2 * learner.recipe.pairs * steps_per_second, 1)
    if not math.isfinite(found.total(learner.recipe).item()):
        raise GelgateError(
            f"the loss is not finite at step {learner.step}; start again with a lower max_rate"
        )
    return entry


def _line(entry: dict[str, Any], recipe: TrainConfig) -> str:
    words = [f"{name} {value:.4g}" for name, value in entry.items() if name not in ("step", "rate")]
    left = (recipe.steps - entry["step"]) * 2 * recipe.pairs / max(entry["frames_per_second"], 1e-9) / 60
    return f"step {entry['step']}/{recipe.steps}  {'  '.join(words)}  {left:.0f} min left"
