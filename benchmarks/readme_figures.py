"""Write the tables of figures in README and docs from ``benchmarks/results``: they cannot go stale.

python -m benchmarks.readme_figures
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAPER = ROOT / "training" / "veilcam_training" / "experiments" / "paper.json"
BEGIN, END = "<!-- figures -->\n", "<!-- end of figures -->"

Figures = dict[str, tuple[str, str, str]]
"""In which file a figure stands, what it is in words, and how it is shown."""

README: Figures = {
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
    **{
        f"mnist_FC800_learned_{size}": (
            "training",
            f"MNIST test accuracy, learned mask, one hidden layer (FC-800), {size}",
            "{:.2f} %",
        )
        for size in ("24x32", "12x16", "6x8", "3x4")
    },
    **{
        f"robust_{change}": ("training", f"{objects}, learned mask, best head, 24x32", "{:.2f} %")
        for change, objects in {
            "shift": "digits anywhere in the view",
            "rescale": "digits 2 to 20 cm tall",
            "rotate": "digits turned by up to 90 degrees to either side",
            "perspective": "digits tilted",
        }.items()
    },
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
    "fresh_mnist_24x32": (
        "fresh-masks",
        "MNIST behind masks never used before, one for each of 10,000 captures, 24 x 32",
        "{:.2f} %",
    ),
    "fresh_mnist_shift": (
        "fresh-masks",
        "the same, digits anywhere in the field of view",
        "{:.2f} %",
    ),
    "prepare_ms": ("fresh-masks", "preparing such a mask, on one core", "{:.0f} ms"),
    "decode_classify_ms": ("fresh-masks", "decoding and classifying, on one core", "{:.1f} ms"),
    "cluster_ari_white": (
        "fresh-masks",
        "clustering `white` embeddings by mask, no key, no epoch's name: best adjusted Rand index",
        "{:.4f}",
    ),
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

KEYS: Figures = {
    name: ("keys", words, pattern)
    for name, (words, pattern) in {
        "past_opened": (
            "earlier captures opened with state directory and memory of the daemon, of 1,000",
            "{}",
        ),
        "forgeries_taken": ("forged answers that a receiver took for true, of 10,000", "{}"),
        "epochs_repeated": (
            "names, keys and numbers that came twice, over 200 kills, restored states and clones",
            "{:.0f}",
        ),
        "clear_part_auc": (
            "two scenes told apart by a classifier trained on what `sealed` answers show: AUC",
            "{:.3f}",
        ),
        "white_digit_advantage_upper": (
            "digits read from `white`, one capture a mask: points above chance, at most",
            "{:.2f}",
        ),
        "white_presence_auc": ("whether anything is there, from `white`: AUC", "{:.3f}"),
        "white_linkage_auc": ("whether two `white` show the same scene: AUC", "{:.3f}"),
        "seal_open_ms": ("sealing and opening an embedding, 24 x 32", "{:.2f} ms"),
        "fresh_accuracy_sealed": (
            "MNIST by the holder of a receiver's key, fresh masks, 24 x 32",
            "{:.2f} %",
        ),
    }.items()
}

MORE_KEYS: Figures = {
    **{
        f"clear_part_auc_{form}": (
            "keys",
            f"two scenes told apart by the clear part of answers with `{form}`: AUC",
            "{:.3f}",
        )
        for form in ("sealed", "white")
    },
    **{
        f"{where}white_{question}": ("keys", f"{words}{said}", pattern)
        for where, said in {"": "", "rest_": ", over REST"}.items()
        for question, words, pattern in (
            ("kind_advantage_upper", "the kind of scene, from `white`: points, at most", "{:.2f}"),
            (
                "skin_advantage_upper",
                "skin of drawn faces, from `white`: points, at most",
                "{:.2f}",
            ),
            (
                "presence_auc_upper",
                "whether anything is there, from `white`: AUC, at most",
                "{:.3f}",
            ),
            ("linkage_auc_upper", "whether two `white` show the same: AUC, at most", "{:.3f}"),
            ("digit_advantage", "digits read from `white`: points above chance", "{:.2f}"),
        )
    },
    "legacy_white_digit_advantage": (
        "keys",
        "digits read from `white` as it was, with its length: points above chance",
        "{:.1f}",
    ),
    "seal_open_first_ms": (
        "keys",
        "sealing, and opening the first embedding of an epoch, 24 x 32",
        "{:.2f} ms",
    ),
    "prepare_sealed_ratio": ("keys", "preparing an epoch, over preparing its mask", "{:.2f} x"),
}

CAPTURE_LOG: Figures = {
    "log_forgeries_missed": (
        "proof",
        "records of a log of 10,000 that were changed, dropped or swapped unnoticed",
        "{:.0f}",
    ),
    "log_record_ms": ("proof", "digest, signature and write of one record", "{:.2f} ms"),
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

CALIBRATED: Figures = {
    f"{knob}_{when}{figure}": ("daemon-calibration", f"{words}: {what}, decoded {said}", pattern)
    for knob, words in {
        "drawn": "nominal",
        "shift_y_150um": "mask 150 um off",
        "dead_lines": "a row and a column stuck open",
        "everything": "shift, rotation, distance, gamma, floor and a dead row at once",
        "gamma_2.2": "gamma 2.2",
        "leakage_0.2": "filters leak 20 % of the amplitude",
        "stray_0.1": "10 % stray light",
        "warm_up_0.1": "10 % of the light missing at first",
        "noise_30db": "noise of 30 dB, not 40",
    }.items()
    for figure, what, pattern in (
        ("", "digits read right", "{:.1%}"),
        ("_unexplained", "error of the scene", "{:.2f}"),
    )
    for when, said in {"before": "as nominal", "after": "as calibrated"}.items()
}

SERVED: Figures = {
    f"served_{when}": ("daemon-calibration", f"digits that a daemon reads {words}", "{:.0%}")
    for when, words in {
        "before": "as its camera is drawn",
        "after": "once it was calibrated",
        "again": "after a restart, with the record",
    }.items()
}

DISTANCE: Figures = {
    f"distance_{light}_um": (
        "daemon-calibration",
        f"distance found, over the true one: {words}",
        "{:.1f} um",
    )
    for light, words in {
        "grid_1": "light off the simulated camera's grid",
        "grid_2": "off one twice as fine",
        "grid_4": "off one four times as fine",
        "transfer": "light by the operator",
    }.items()
}

CHECKS: Figures = {
    f"make_{target}_{figure}": ("house", f"`make {target}`, {words}", "{:.0f} s")
    for target in ("lint", "types", "layers", "check", "test")
    for figure, words in {"wall_s": "wall", "user_cpu_s": "time of all cores"}.items()
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

SIEGE: Figures = {
    name: ("siege", words, pattern)
    for name, (words, pattern) in {
        "siege_status_p99_ms": (
            "`status` from another address under attack, 99 of 100, worst row",
            "{:.0f} ms",
        ),
        "siege_log_bytes_per_s": ("log of an attack, worst row", "{:.0f} B/s"),
        "siege_rss_growth_mb": ("memory that an attack takes, worst row", "{:.0f} MB"),
        "state_faults_tried": ("damaged state: starts tried", "{:.0f}"),
        "starts_refused": ("of them refused", "{:.0f}"),
        "silent_rollbacks": ("that rolled something back in silence", "{:.0f}"),
        "beyond_budget": ("embeddings beyond the budget of their mask", "{:.0f}"),
        "kills": ("kills", "{:.0f}"),
        "kills_lost": ("what was acknowledged and lost", "{:.0f}"),
        "epochs_repeated": ("epochs that came again", "{:.0f}"),
    }.items()
}


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

HONESTY: Figures = {
    "oracle_jobs": ("optics", "random cameras, scenes and conditions", "{:.0f}"),
    "oracle_honest_fraction": (
        "optics",
        "of those judged: true error at most twice the predicted one",
        "{:.3f}",
    ),
    "oracle_worst_reached_ratio": (
        "optics",
        'worst plan that says "reached": true error over the predicted one, or tolerance / 10',
        "{:.1f}",
    ),
    "oracle_sharpness_median": ("optics", "predicted over true error, median", "{:.1f}"),
    "oracle_sharpness_95": ("optics", "predicted over true error, 95 % below", "{:.0f}"),
    "oracle_reached_fraction": (
        "optics",
        'plans that say "reached", of those that the finest setting reaches',
        "{:.3f}",
    ),
    "oracle_unjudged_fraction": ("optics", "refused, or the oracle is not sure", "{:.3f}"),
    "oracle_worst_time_over_best": (
        "optics",
        "a plan's predicted time over that of the fastest honest setting, at worst",
        "{:.2f} x",
    ),
    "default_scene_exact_error": (
        "optics",
        "default camera and scene, tolerance 1e-2: true error",
        "{:.1e}",
    ),
    "exact_honest_fraction": ("optics", "100 everyday cameras: honest", "{:.3f}"),
    "plan_cpu_ms": ("optics", "planning the default job, fresh process, CPU", "{:.0f} ms"),
}

LIMIT: Figures = {
    "transfer_over_matmul": (
        "optics",
        "a mask's transfer over the largest of its products of matrices",
        "{:.2f} x",
    ),
    "mask_batch_speedup": ("optics", "64 masks at once over one by one, 3 x 4", "{:.1f} x"),
    "numpy_torch_max_difference": (
        "optics",
        "NumPy against torch: transfers, decoded scenes, releases, relative",
        "{:.1e}",
    ),
}

TOLERANCE: Figures = {
    f"tolerance_{kind}_{way}": ("optics", f"{kind} mask, light in a fit: {words}", "{:.1f} %")
    for kind in ("learned", "fixed")
    for way, words in {
        "shadows_of_whole_cells_gray": "shadows of whole cells, gray",
        "shadows_without_dead_space": "shadows without dead space",
        "shadows": "shadows",
        "all_but_interference": "all but interference",
        "nearest_interference": "nearest interference",
        "all": "all",
        "all_but_interference_all_at_the_end": "all in the last quarter alone",
    }.items()
}

CARD_ROWS = {
    "T0": ("digits read with the key, at least", "{:.1f} %"),
    "T1": ("ciphertext only: points above chance", "{:.1f}"),
    "T2": ("wrong key: points", "{:.1f}"),
    "T3": ("pairs of other epochs: points", "{:.1f}"),
    "T4": ("known pairs of this mask: points", "{:.1f}"),
    "T5": ("leaked list: points", "{:.1f}"),
    "T6": ("full leak: nearer than the mean picture", "{:.1f} dB"),
    "T7": ("many shots: points", "{:.1f}"),
    "T8": ("attributes from scores: AUC less one half", "{:.3f}"),
    "T9": ("linkage: AUC less one half", "{:.3f}"),
}
CARD_MODES = {
    "fresh": "fresh, `white`",
    "pairs1": "1 pair, `raw`",
    "pairs10": "10 pairs, `raw`",
    "pairs100": "100 pairs, `raw`",
    "random": "random masks, `raw`",
}
CARD_TIME: Figures = {"card_quick_minutes": ("privacy", "a quick card, two cores", "{:.1f} min")}


def cards() -> str:
    """Cards side by side: a row for each threat, a column for each mode."""
    figures = json.loads((ROOT / "benchmarks" / "results" / "privacy.json").read_text())
    lines = [
        "| row | what | " + " | ".join(CARD_MODES.values()) + " |",
        "|---|---|" + "---|" * len(CARD_MODES),
    ]
    for row, (what, pattern) in CARD_ROWS.items():
        cells = [pattern.format(figures[f"card_{mode}_{row}"]["value"]) for mode in CARD_MODES]
        lines.append(f"| [{row}](#{row.lower()}) | {what} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


LEGACY: Figures = {
    name: ("privacy", words, pattern)
    for name, (words, pattern) in {
        "white_length_digit_legacy": ("`white` with its length: digit by length alone", "{:.1f} %"),
        "white_length_link_auc_legacy": ("the same scene behind two masks, AUC", "{:.3f}"),
        "white_length_rank1_legacy": ("the same among 50, rank 1", "{:.1f} %"),
        "white_length_presence_legacy": ("whether anything is there", "{:.1f} %"),
        "white_length_skin_legacy": ("skin of drawn faces", "{:.1f} %"),
        "flat_keyless_legacy": ("`flat`: network trained on other keys", "{:.1f} %"),
        "raw_keyless_legacy": ("`raw`: the same", "{:.1f} %"),
        "flat_cosine_auc_legacy": ("`flat`: the same scene behind two masks, AUC", "{:.3f}"),
        **{
            f"kpa_{masks}_{known}_legacy": (f"{words}: read after {said}", "{:.1f} %")
            for masks, words in {
                "raw": "`raw`, random mask",
                "learned": "`raw`, learned mask",
                "flat": "`flat`, random mask",
            }.items()
            for known, said in {
                "one_pair": "one known picture",
                "four_pairs": "four",
                "zero_pairs": "none, but 500 captures",
            }.items()
        },
        **{
            f"white_known_{count}_legacy": (
                f"`white`, many captures of a mask: read with {count:,} labelled ones",
                "{:.1f} %",
            )
            for count in (30, 100, 1000, 2000)
        },
        "white_epoch_link_auc_legacy": ("the same scene behind one mask, AUC", "{:.3f}"),
    }.items()
}

PAGES: dict[str, list[Figures | Callable[[], str]]] = {
    "CONTRIBUTING.md": [CHECKS],
    "README.md": [README | KEYS],
    "docs/accuracy.md": [LIMIT, TOLERANCE],
    "docs/effects.md": [HONESTY],
    "docs/privacy-card.md": [cards, CARD_TIME],
    "docs/attacks.md": [CONVEX, GENERATOR, ATTRIBUTES, LEGACY],
    "docs/bundle.md": [CONDITIONING],
    "docs/fresh-masks.md": [FRESH, RELEASED, TIMES],
    "docs/siege.md": [SIEGE],
    "docs/threat-model.md": [KEYS | MORE_KEYS | CAPTURE_LOG],
    "docs/calibration.md": [DISTANCE, SERVED, CALIBRATED],
}
"""The tables of each page, from top to bottom."""


def table(shown: Figures) -> str:
    """One table in Markdown; figures that were not measured yet are left out."""
    lines = ["| what | measured | command |", "|---|---|---|"]
    for name, (file, words, pattern) in shown.items():
        path = ROOT / "benchmarks" / "results" / f"{file}.json"
        figures = json.loads(path.read_text()) if path.exists() else {}
        if name in figures:
            value = pattern.format(figures[name]["value"])
            lines.append(f"| {words} | {value} | `{figures[name]['command']}` |")
    return "\n".join(lines) + "\n"


def with_tables(name: str, page: str) -> str:
    """The text of page ``name`` with its tables replaced."""
    first, *parts = page.split(BEGIN)
    tables = PAGES[name]
    if len(parts) != len(tables):
        raise ValueError(f"{name} has {len(parts)} tables, not {len(tables)}")
    for shown, part in zip(tables, parts, strict=True):
        first += BEGIN + (shown() if callable(shown) else table(shown)) + END + part.split(END)[1]
    return first


def main() -> None:
    """Rewrite the pages."""
    for name in PAGES:
        path = ROOT / name
        path.write_text(with_tables(name, path.read_text()))


if __name__ == "__main__":
    main()
