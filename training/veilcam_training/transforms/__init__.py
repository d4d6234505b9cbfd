"""Transforms of images into scenes: placed, warped, augmented."""
