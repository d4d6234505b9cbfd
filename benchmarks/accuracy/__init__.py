"""Error against time of every way to compute light, Algorithm 1 of the paper among them."""
