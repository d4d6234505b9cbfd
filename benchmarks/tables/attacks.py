"""Attacks of the paper, beside its numbers."""

from __future__ import annotations

import json

from benchmarks.tables.table import ROOT, Figures, Grid

PAPER = json.loads((ROOT / "benchmarks" / "paper" / "paper.json").read_text())["attacks"]
MASKS = {
    "1": "1 learned mask",
    "10": "10 learned masks",
    "100": "100 learned masks",
    "10random": "10 random masks",
}

CONVEX = Grid(
    "privacy",
    "embedding",
    {size: size for size in ("384x512", "192x256", "96x128", "48x64", "24x32", "6x8", "3x4")},
    {
        f"convex_{metric}_{psf}_{{}}": (f"{words}, {metric.upper()}", pattern)
        for psf, words in {"good": "right PSF", "bad": "another mask's PSF"}.items()
        for metric, pattern in (("psnr", "{:.1f} dB"), ("ssim", "{:.2f}"))
    },
    PAPER,
)

CONVEX_BESIDE: Figures = {
    "convex_psnr_mean_picture": (
        "privacy",
        "no capture at all: the mean picture of the training set, PSNR",
        "{:.1f} dB",
    ),
    **{
        f"convex_untuned_psnr_{psf}_{size}": (
            "privacy",
            f"{words}, {size}, the attacker does not tune: PSNR",
            "{:.1f} dB",
        )
        for size in ("384x512", "24x32")
        for psf, words in {"good": "right PSF", "bad": "another mask's PSF"}.items()
    },
    **{
        f"convex_gain_least_{size}": (
            "privacy",
            f"right PSF over the other, {size}: at least (99 %)",
            "{:.2f} dB",
        )
        for size in ("384x512", "24x32", "3x4")
    },
    "convex_gap": (
        "privacy",
        "duality gap after 400 iterations with 40 dual steps each, worst cell, of a black scene's",
        "{:.0e}",
    ),
}

GENERATOR = Grid(
    "privacy",
    "masks and pairs",
    {"mean_picture": "no capture at all: the mean picture of the training set"}
    | {
        f"{masks}_{pairs}": f"{words}, {pairs:,} pairs"
        for masks, words in MASKS.items()
        for pairs in (100, 1000, 10_000)
    },
    {
        "generator_psnr_{}": ("PSNR", "{:.1f} dB"),
        "generator_ssim_{}": ("SSIM", "{:.2f}"),
    },
    PAPER,
)

ATTRIBUTES = Grid(
    "privacy",
    "AUC behind",
    MASKS,
    {
        f"attribute_auc_{attribute}_{{}}_{pairs}": (f"{attribute}, {pairs:,} pairs", "{:.3f}")
        for attribute in ("gender", "smiling")
        for pairs in (1000, 10_000)
    },
)
