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

CONDITIONING: Figures = {
    **{
        f"conditioning_{masks}_{name}": ("conditioning", f"least `{name}`, {words}", "{:.2f}")
        for masks, words in (("drawn", "masks drawn from a key"), ("learned", "learned masks"))
        for name in ("directions", "spread", "own")
    },
    **{
        f"conditioning_refused_{name}": (
            "conditioning",
            f"refused at the embedding where fewest are: {words}",
            "{:.1%}",
        )
        for name, words in (
            ("1_open", "one open pixel anywhere"),
            ("2_open", "two open pixels anywhere"),
            ("3_open", "three open pixels anywhere"),
            ("open_window", "open window, up to 20 % of noise"),
            ("half", "half of the window open"),
            ("gradient", "gradient"),
        )
    },
    "conditioning_ms": ("conditioning", "time for one mask, 24 x 32", "{:.0f} ms"),
    "conditioning_open_ms": ("conditioning", "time for a bundle of mode `fresh`", "{:.0f} ms"),
}
