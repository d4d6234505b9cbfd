"""Watch: captures that the camera takes by itself, and the sightings that it reports."""
