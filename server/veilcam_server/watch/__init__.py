"""A camera that looks by itself: belief, sightings, hours, and the task that looks."""
