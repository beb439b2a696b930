"""A virtual USB bus with a GelSight Mini on it: descriptors, camera, faults and the pyusb backend that serves them."""
