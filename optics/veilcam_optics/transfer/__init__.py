"""Transfer matrices: from a mask to the matrix that maps a scene to its embedding."""
