"""Scores of imported models, run as the gateway runs them, without a bundle around them."""

import numpy as np
from numpy.typing import NDArray
from toy_trunk import features_of

from edge.core.detector import ScoreMaps
from edge.model.session import open_session
from export.importers.contract import Imported


def scores_of(model: Imported, frames: NDArray[np.uint8]) -> ScoreMaps:
    """Maps (n, h, w) and scores (n,), frame by frame."""
    head = open_session(model.head, 1, "imported")
    names = [one.name for one in head.get_inputs()]
    maps, scores = [], []
    for frame in frames:
        features = features_of(model.trunk.graph, frame[None])
        feed = {name: features.get(name, model.bank.arrays.get(name)) for name in names}
        score_map, score = head.run(["score_map", "score"], feed)
        maps.append(score_map[0])
        scores.append(score[0])
    return ScoreMaps(np.array(maps, np.float64), np.array(scores, np.float64))
