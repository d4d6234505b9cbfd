"""README's two commands, with each Python that the package is for."""
