"""``veilcamd demo``: the whole camera end to end, on this machine, in a minute."""
