"""Fresh masks, what leaves behind them, and bundles."""

from __future__ import annotations

from benchmarks.tables.table import Figures

FRESH: Figures = {
    **{
        f"fresh_{task}{suffix}": ("fresh-masks", f"{words}{said}", "{:.2f} %")
        for task, words in {
            "mnist_24x32": "MNIST, 24 x 32",
            "mnist_12x16": "MNIST, 12 x 16",
            "mnist_6x8": "MNIST, 6 x 8",
            "mnist_3x4": "MNIST, 3 x 4",
            "mnist_shift": "MNIST anywhere in the field of view, 24 x 32",
            "fashion_24x32": "Fashion-MNIST, 24 x 32",
        }.items()
        for suffix, said in {
            "": "",
            "_wrong_key": ", read by an attacker who does not adapt: decoded with another key",
        }.items()
    },
}

RELEASED: Figures = {
    f"{figure}_{form}{suffix}": ("fresh-masks", f"{words}, form `{form}`{said}", pattern)
    for figure, words, pattern in (
        ("cluster_ari", "masks told apart without a key (adjusted Rand index)", "{:.4f}"),
        ("keyless_accuracy", "digits read without a key, many masks known", "{:.1f} %"),
    )
    for form in ("raw", "white")
    for suffix, said in {"": "", "_exponent4": ", sparse masks"}.items()
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
    name: ("hiding", words, "{:.1%}")
    for name, words in {
        "shipped_seen_worst": "an eye sees, behind the worst shipped mask",
        "random_seen": "an eye sees, behind random masks",
        "pinhole_seen": "an eye sees, behind one pinhole",
        "shipped_recognised": "a machine recognises, behind the worst shipped mask",
        "random_recognised": "a machine recognises, behind random masks",
        "shipped_read": "a machine reads digits, behind the worst shipped mask",
        "random_read": "a machine reads digits, behind random masks",
        "read_24x32": "a machine reads digits, random masks, 24 x 32",
        "read_12x16": "a machine reads digits, random masks, 12 x 16",
        "read_6x8": "a machine reads digits, random masks, 6 x 8",
        "read_3x4": "a machine reads digits, random masks, 3 x 4",
    }.items()
} | {
    f"{camera}_refused_{name}": ("hiding", f"a daemon refuses in {camera}: {words}", "{:.1%}")
    for camera in ("gray", "colour")
    for name, words in {
        "1_holes": "one hole",
        "50_holes": "fifty holes",
        "hole_in_50_even": "a hole in an even ground of 50 %",
        "hole_in_50_random": "a hole in a random ground of 50 %",
        "stripes_random": "stripes",
        "random": "random masks",
    }.items()
}
