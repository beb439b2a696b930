"""Registration: a press brought to the pose in which the bank was learnt."""
