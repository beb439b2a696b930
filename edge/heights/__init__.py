"""Files of heights: the calibration of a gel, and height maps for people and for metrology programs."""
