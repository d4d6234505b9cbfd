"""Figures of attackers: keys, logs, the siege, and privacy cards."""

from __future__ import annotations

import json

from benchmarks.tables.table import ROOT, Figures

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
        "seal_open_ms": ("sealing and opening an embedding, 24 x 32", "{:.2f} ms"),
        "fresh_accuracy_sealed": (
            "MNIST by the holder of a receiver's key, fresh masks, 24 x 32",
            "{:.2f} %",
        ),
    }.items()
}

MORE_KEYS: Figures = {
    "measurements_in_memory": (
        "privacy",
        "raw measurements of 200 in the daemon's memory after 5 further captures",
        "{:.0f}",
    ),
    "seal_open_first_ms": (
        "keys",
        "sealing, and opening the first embedding of an epoch, 24 x 32",
        "{:.2f} ms",
    ),
    "pairing_attacks_won": (
        "people",
        "receivers paired, secrets told or roles gained by 1,160 attacks on pairing",
        "{:.0f}",
    ),
    "prepare_sealed_ratio": ("keys", "preparing an epoch, over preparing its mask", "{:.2f} x"),
}

CAPTURE_LOG: Figures = {
    "log_forgeries_missed": (
        "log",
        "records of a log of 10,000 that were changed, dropped or swapped unnoticed",
        "{:.0f}",
    ),
    "log_record_ms": ("log", "digest, signature and write of one record", "{:.2f} ms"),
}

GUARD: Figures = {
    name: ("guard", words, pattern)
    for name, (words, pattern) in {
        "faults_tried": ("mask changes behind five kinds of broken panel, simulated", "{:,.0f}"),
        "faults_answered": ("of them answered in light enough for a verdict", "{:.0f}"),
        "rest_faults_tried": ("faults of a daemon over REST, a mask for each capture", "{:.0f}"),
        "rest_faults_answered": ("of them answered, first capture included", "{:.0f}"),
        "sound_cameras": ("sound cameras drawn, 300,000 changes under switched lamps", "{:.0f}"),
        "sound_accused": ("of these changes accused", "{:.0f}"),
        "sound_worst_ratio": ("worst ratio of opaque to mask, sound", "{:.2f}"),
        "lost_wrong_before": ("wrong masks in 4,400 captures, written once, no guard", "{:.0f}"),
        "lost_wrong_after": ("the same, written twice, with guard", "{:.0f}"),
        "guard_rate_ten_captures": ("rate with the guard over without, ten a mask", "{:.2f} x"),
        "guard_rate_one_capture": ("the same, one capture a mask", "{:.2f} x"),
        "held_latency_ms": ("latency of held answers, median", "{:.0f} ms"),
        "latency_auc": ("two scenes told apart by latency: AUC", "{:.2f}"),
    }.items()
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
    "fresh": "fresh, `sealed`",
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
