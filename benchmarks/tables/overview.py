"""What the README and the page of all figures show."""

from __future__ import annotations

from benchmarks.tables.table import Figures
from benchmarks.tables.threats import KEYS

TRAINED: Figures = {
    "demo_accuracy": ("main-job", "demo: held-out digits read right through six masks", "{:.3f}"),
    "demo_wrong_classifier_accuracy": (
        "main-job",
        "the same by an attacker who does not adapt: with the classifier of another mask",
        "{:.3f}",
    ),
    "mnist_lr_learned_24x32": (
        "main-job",
        "MNIST test accuracy, learned mask, linear classifier, 24 x 32",
        "{:.2f} %",
    ),
    "mnist_FC800_learned_24x32": (
        "training",
        "MNIST test accuracy, learned mask, one hidden layer (FC-800), 24x32",
        "{:.2f} %",
    ),
    "mnist_FC800_learned_12x16": (
        "training",
        "MNIST test accuracy, learned mask, one hidden layer (FC-800), 12x16",
        "{:.2f} %",
    ),
    "mnist_FC800_learned_6x8": (
        "training",
        "MNIST test accuracy, learned mask, one hidden layer (FC-800), 6x8",
        "{:.2f} %",
    ),
    "mnist_FC800_learned_3x4": (
        "training",
        "MNIST test accuracy, learned mask, one hidden layer (FC-800), 3x4",
        "{:.2f} %",
    ),
    "robust_shift": (
        "training",
        "digits anywhere in the view, learned mask, best head, 24x32",
        "{:.2f} %",
    ),
    "robust_rescale": (
        "training",
        "digits 2 to 20 cm tall, learned mask, best head, 24x32",
        "{:.2f} %",
    ),
    "robust_rotate": (
        "training",
        "digits turned by up to 90 degrees to either side, learned mask, best head, 24x32",
        "{:.2f} %",
    ),
    "robust_perspective": ("training", "digits tilted, learned mask, best head, 24x32", "{:.2f} %"),
    "panel_trained_erring_shown_erring": (
        "training",
        "20 panels that err show one mask trained for that, FC-800, 12x16: mean (validation)",
        "{:.2f} %",
    ),
    "panel_trained_ideal_shown_erring": (
        "training",
        "the same of a mask trained for an ideal panel",
        "{:.2f} %",
    ),
    "fit50_minutes": ("training", "50 epochs of FC-800 behind a learned mask", "{:.1f} min"),
}
LIGHT: Figures = {
    "step_ratio_learned_over_fixed": (
        "main-job",
        "training step with a learned mask, over one with a fixed mask",
        "{:.2f} x",
    ),
    "transfer_error_24x32": (
        "main-job",
        "transfer operator against the whole field, 16 times oversampled",
        "{:.1e}",
    ),
    "transfer_time_waveprop_over_ours": (
        "optics",
        "mask to 24 x 32 embedding: waveprop's time over ours",
        "{:.0f} x",
    ),
    "step_time_waveprop_over_ours": (
        "optics",
        "learned-mask training step: waveprop's time over ours",
        "{:.0f} x",
    ),
    "step_ratio_learned_over_fixed_b512": (
        "optics",
        "the same at batch 512, over a step with a fixed mask and measurements made beforehand",
        "{:.2f} x",
    ),
    "step_peak_rss_mb": ("optics", "memory of that step, at its peak", "{:.0f} MB"),
    "oracle_honest_fraction": (
        "optics",
        "plans whose error against exact light is at most twice the predicted one, any camera",
        "{:.3f}",
    ),
}
UNUSED: Figures = {
    "fresh_mnist_shift": (
        "fresh-masks",
        "MNIST anywhere in the field of view, behind masks never used before, 24 x 32",
        "{:.2f} %",
    ),
    "prepare_ms": ("fresh-masks", "preparing such a mask, on one core", "{:.0f} ms"),
    "decode_classify_ms": ("fresh-masks", "decoding and classifying, on one core", "{:.1f} ms"),
}
DAEMON: Figures = {
    "overhead_median_ms": (
        "daemon",
        "a classification over REST, beyond the device's own time, 8 clients: median",
        "{:.1f} ms",
    ),
    "overhead_p99_ms": ("daemon", "the same, 99 % of them", "{:.1f} ms"),
    "l2_passed": (
        "daemon",
        "the unit in a virtual machine, sandbox and watchdog included: 1 if every check passes",
        "{:d}",
    ),
}
_ALL = TRAINED | LIGHT | UNUSED | DAEMON | KEYS
HEADLINES: Figures = {
    name: _ALL[name]
    for name in (
        "fresh_accuracy_sealed",
        "clear_part_auc",
        "past_opened",
        "step_time_waveprop_over_ours",
        "overhead_median_ms",
    )
}
"""Five that matter, for the README."""
