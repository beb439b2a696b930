"""What a new gel costs: presses of one part on two gels of one sensor, and ways to keep a bundle."""
