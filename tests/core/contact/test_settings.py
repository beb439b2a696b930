"""The settings of the contact rules."""

import pytest

from edge.core.contact.settings import ContactSettings


def test_settings_refuse_nonsense() -> None:
    for make in (
        lambda: ContactSettings(on_area=0.001),
        lambda: ContactSettings(off_area=0),  # a lift would never be seen
        lambda: ContactSettings(still_share=1),
        lambda: ContactSettings(release_share=-0.1),
        lambda: ContactSettings(onset_s=-1),
        lambda: ContactSettings(settle_timeout_s=0.1),
        lambda: ContactSettings(min_frames=0),
        lambda: ContactSettings(stuck_s=0),
        lambda: ContactSettings(light_levels=0),
    ):
        with pytest.raises(ValueError, match="found"):
            make()
    ContactSettings(min_frames=1, baseline_frames=1, refresh_s=0.5, stuck_s=0.5, light_levels=0.5)
