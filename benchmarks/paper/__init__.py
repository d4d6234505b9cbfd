"""The paper's tables: their cells, how they are run, and the report that sets ours beside them."""
