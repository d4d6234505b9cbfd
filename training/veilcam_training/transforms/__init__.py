"""How images become scenes: placed, warped, augmented."""
