"""Heights of a press in millimetres, from the colours of its picture: calibrated slopes, integrated."""
