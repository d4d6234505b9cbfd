"""The report card: every threat, its worst attacker, and what had been said beforehand."""
