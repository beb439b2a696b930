"""What a score map is compared with: one limit for all places, the surroundings of each place, or the place's own."""
