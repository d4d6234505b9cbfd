"""Tables of figures in README and docs, by what they are of."""
