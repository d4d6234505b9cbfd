"""Training: data sets, encoders, classifiers, fitting and bundles."""
