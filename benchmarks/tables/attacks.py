"""Attacks of the paper, beside its numbers."""

from __future__ import annotations

import json

from benchmarks.tables.table import ROOT, Figures

PAPER = ROOT / "benchmarks" / "paper" / "paper.json"


def beside_paper(name: str, words: str, pattern: str) -> tuple[str, str, str]:
    """A figure of an attack beside the paper's, where the paper has one."""
    published = json.loads(PAPER.read_text())["attacks"]
    beside = f" (paper: {pattern.format(published[name])})" if name in published else ""
    return "privacy", f"{words}{beside}", pattern


CONVEX: Figures = {
    "convex_psnr_mean_picture": (
        "privacy",
        "no capture at all: the mean picture of the training set, PSNR",
        "{:.1f} dB",
    ),
    **{
        f"convex_{metric}_{psf}_{size}": beside_paper(
            f"convex_{metric}_{psf}_{size}", f"{words}, {size}: {metric.upper()}", pattern
        )
        for size in (
            *("384x512", "192x256", "96x128", "48x64", "24x32"),
            *("6x8", "3x4"),
        )
        for psf, words in {"good": "right PSF", "bad": "another mask's PSF"}.items()
        for metric, pattern in (("psnr", "{:.1f} dB"), ("ssim", "{:.2f}"))
    },
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

GENERATOR: Figures = {
    "generator_psnr_mean_picture": (
        "privacy",
        "no capture at all: the mean picture of the training set, PSNR",
        "{:.1f} dB",
    ),
    **{
        f"generator_{metric}_{masks}_{pairs}": beside_paper(
            f"generator_{metric}_{masks}_{pairs}",
            f"{words}, {pairs:,} pairs: {metric.upper()}",
            pattern,
        )
        for masks, words in {
            "1": "1 learned mask",
            "10": "10 learned masks",
            "100": "100 learned masks",
            "10random": "10 random masks",
        }.items()
        for pairs in (100, 1000, 10_000)
        for metric, pattern in (("psnr", "{:.1f} dB"), ("ssim", "{:.2f}"))
    },
}

ATTRIBUTES: Figures = {
    f"attribute_auc_{attribute}_{masks}_{pairs}": (
        "privacy",
        f"{attribute}, {words}, {pairs:,} pairs: AUC",
        "{:.3f}",
    )
    for attribute in ("gender", "smiling")
    for masks, words in {
        "1": "1 learned mask",
        "10": "10 learned masks",
        "100": "100 learned masks",
        "10random": "10 random masks",
    }.items()
    for pairs in (1000, 10_000)
}
