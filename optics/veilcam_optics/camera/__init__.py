"""The camera itself: geometry, sensors, masks, and how it departs from its drawing."""
