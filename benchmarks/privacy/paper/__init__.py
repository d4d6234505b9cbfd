"""The paper's two attacks, and attributes from the same pairs: tables 5 and 6."""
