"""The camera itself: geometry, sensors, masks, and its imperfections."""
