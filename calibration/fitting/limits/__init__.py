"""What a score and a score map are compared with, learnt from presses by banks without them."""
