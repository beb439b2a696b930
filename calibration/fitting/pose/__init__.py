"""Where a part lies in a press: learnt from nominal presses, and whether to register by it."""
