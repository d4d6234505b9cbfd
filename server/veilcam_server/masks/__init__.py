"""Sources of masks, and the classifiers that read behind them."""
