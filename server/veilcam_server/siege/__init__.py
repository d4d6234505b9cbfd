"""``veilcamd siege``: attackers and faults against a simulated daemon of one's own, on loopback."""
