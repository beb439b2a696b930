"""The kernel's way to a camera: which video node belongs to the sensor, its controls, and its frames through OpenCV."""
