"""The JPEG of the training frames does what a real encoder does."""

import cv2
import numpy as np
import pytest
import torch

from calibration.training.jpeg import compressed
from calibration.training.training_pairs import draw_pairs


@pytest.mark.parametrize("quality", [60, 85, 95])
def test_it_agrees_with_a_real_encoder(quality: int) -> None:
    """Within one grey level on average; at quality 60 within a third of the encoder's own error."""
    drawn = draw_pairs(0, "train", 3, pairs=2, side=128, device=torch.device("cpu"), high_resolution=0.0)
    planes = drawn.frames[:2]
    found = compressed(planes, torch.full((2,), float(quality))).permute(0, 2, 3, 1).numpy()
    for ours, sound in zip(found, planes.permute(0, 2, 3, 1).byte().numpy(), strict=True):
        bgr = cv2.cvtColor(sound, cv2.COLOR_RGB2BGR)
        sent = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        theirs = cv2.cvtColor(cv2.imdecode(sent, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB).astype(np.float32)
        assert np.abs(ours - theirs).mean() < 1.0
        if quality == 60:
            assert np.abs(ours - theirs).mean() < np.abs(sound - theirs).mean() / 3


def test_each_picture_has_its_own_quality() -> None:
    """A picture at quality 50 loses more than the same one at 95, and neither depends on its neighbour."""
    picture = draw_pairs(
        0, "train", 5, pairs=1, side=64, device=torch.device("cpu"), high_resolution=0.0
    ).frames[:1]
    both = compressed(torch.cat([picture, picture]), torch.tensor([50.0, 95.0]))
    lost = (both - picture).abs().mean(dim=(1, 2, 3))
    assert lost[0] > 1.2 * lost[1] > 0
    assert torch.equal(compressed(picture, torch.tensor([95.0])), both[1:])


def test_an_even_picture_stays() -> None:
    """A picture of one grey is unchanged."""
    grey = torch.full((1, 3, 32, 32), 119.0)
    assert torch.equal(compressed(grey, torch.tensor([75.0])), grey)
