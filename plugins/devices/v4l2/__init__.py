"""A camera through the kernel: the sensor's video node, its controls, and its frames through OpenCV."""
