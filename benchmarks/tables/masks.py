"""Fresh masks, what leaves behind them, and bundles."""

from __future__ import annotations

from benchmarks.tables.table import Figures, Grid

FRESH = Grid(
    "fresh-masks",
    "what",
    {
        "mnist_24x32": "MNIST, 24 x 32",
        "mnist_12x16": "MNIST, 12 x 16",
        "mnist_6x8": "MNIST, 6 x 8",
        "mnist_3x4": "MNIST, 3 x 4",
        "mnist_shift": "MNIST anywhere in the field of view, 24 x 32",
        "fashion_24x32": "Fashion-MNIST, 24 x 32",
    },
    {
        "fresh_{}": ("read right", "{:.2f} %"),
        "fresh_{}_wrong_key": ("decoded with another key", "{:.2f} %"),
    },
)

RELEASED: Figures = {
    "cluster_ari_raw": (
        "fresh-masks",
        "masks told apart without a key (adjusted Rand index), form `raw`",
        "{:.4f}",
    ),
    "keyless_accuracy_raw": (
        "fresh-masks",
        "digits read without a key, many masks known, form `raw`",
        "{:.1f} %",
    ),
}

TIMES: Figures = {
    "prepare_ms": ("fresh-masks", "preparing a mask", "{:.1f} ms"),
    "decode_classify_ms": ("fresh-masks", "decoding and classifying a capture", "{:.2f} ms"),
    "classifier_macs": ("fresh-masks", "multiply-adds of the classifier", "{:,}"),
    "soak_captures": ("daemon", "captures on hardware that fails, a mask each", "{:,}"),
    "soak_reused": (
        "daemon",
        "masks or epochs used again, after kills and clock jumps",
        "{}",
    ),
    "soak_mixed": ("daemon", "measurements that mixed two masks", "{}"),
}

HIDING: Figures = {
    key: ("hiding", words, "{:.0%}")
    for key, words in (
        ("shipped_seen_worst", "seen, worst of the shipped masks (a guess: 1 %)"),
        ("random_seen", "seen, random masks"),
        ("pinhole_seen", "seen, one pinhole"),
        ("shipped_recognised", "recognised, worst of the shipped masks (a guess: 1 %)"),
        ("random_recognised", "recognised, random masks"),
        ("shipped_read", "read, worst of the shipped masks (a guess: 11 %)"),
        ("random_read", "read, random masks, 24 x 32"),
        ("read_12x16", "read, random masks, 12 x 16"),
        ("read_6x8", "read, random masks, 6 x 8"),
        ("read_3x4", "read, random masks, 3 x 4"),
    )
}

REFUSED = Grid(
    "hiding",
    "masks",
    {
        "1_holes": "one hole",
        "15_holes": "15 holes",
        "50_holes": "50 holes",
        "hole_in_50_even": "a hole in an even ground of half the amplitude",
        "hole_in_50_random": "a hole in a random ground of half the amplitude",
        "stripes_random": "stripes",
        "halves": "halves",
        "random": "random masks",
    },
    {
        "gray_refused_{}": ("refused, 24 x 32", "{:.0%}"),
        "colour_refused_{}": ("refused, 27 x 36 in colour", "{:.0%}"),
    },
)
