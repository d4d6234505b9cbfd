// Privacy: what leaves the camera, to whom, and what attacks on its masks found.

import { get } from "./api.js";
import { card, columns, empty, facts, h } from "./dom.js";
import { RELEASES, THREATS, day } from "./words.js";

// A privacy card, as elements.
export function cardResult(made, label) {
  if (!made) {
    return empty("These masks have no privacy card: nobody has attacked them, or whoever did wrote no card.");
  }
  const depth = made.quick ? "a quick card, of few masks and light attackers" : "a full card";
  const heads = ["Threat", "Outcome", "Reached", "At most"].map((text) => h("th", { scope: "col" }, text));
  const rows = made.rows.map((row) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, `${row.threat} ${THREATS[row.threat] ?? ""}`),
      [row.outcome, `${row.figure} ${row.unit}`, `${row.end} ${row.unit}`].map((text) => h("td", {}, text)),
    ),
  );
  return [
    h("p", { class: "big" }, made.outcome),
    h("p", { class: "note" }, `Of masks “${made.mode}”, embeddings ${made.form}; ${depth}, made ${day(made.made_at)}.`),
    h(
      "div",
      { class: "scroll", tabindex: "0", role: "region", "aria-label": label },
      h("table", {}, h("thead", {}, h("tr", {}, heads)), h("tbody", {}, rows)),
    ),
  ];
}

export function privacyView(camera) {
  const place = h("div", {});
  const learned = h("ul", { class: "findings" });
  let drawn = "";

  async function load() {
    const { observers } = await get("/v1/privacy");
    learned.replaceChildren(...observers.map(observer));
  }

  function observer({ who, learns, measured, switch: change }) {
    return h("li", {}, h("b", {}, `Who ${who}`), h("span", {}, learns), h("span", {}, `Measured: ${measured}.`), h("span", {}, `Switch: ${change.replaceAll("`", "")}.`));
  }

  function leaves({ release, raw_budget: budget, receivers }) {
    const paired = `Sealed to ${receivers.length || "no"} ${receivers.length === 1 ? "receiver" : "receivers"}: see `;
    return card(
      "What leaves",
      h("p", {}, RELEASES[release]),
      release === "raw" ? h("p", {}, `At most ${budget} behind one mask.`) : null,
      h("p", {}, paired, h("a", { href: "#receivers" }, "Receivers"), "."),
      h("p", { class: "note" }, "No mask and no frame of the sensor ever leaves, here neither."),
    );
  }

  function masks({ bundle }) {
    const what = bundle.mode === "fresh" ? "A new mask is drawn from a key for every epoch, and no list of masks exists." : `${bundle.pairs} stored masks take turns.`;
    const pairs = [
      ["Task", bundle.task],
      ["Labels", bundle.labels.join(", ")],
      ["Embedding", bundle.embedding_shape.join(" × ")],
      ["Version", bundle.version ? String(bundle.version) : "none"],
      ["Signed by", bundle.signed_by ?? "nobody"],
    ];
    return card(
      "Masks",
      h("p", {}, what),
      bundle.hiding ? bundle.hiding.found.map((text) => h("p", {}, text)) : null,
      facts(pairs),
    );
  }

  return {
    elements: [place],
    update() {
      const { status } = camera;
      const now = JSON.stringify([status.release, status.raw_budget, status.receivers, status.bundle]);
      if (now === drawn) return;
      drawn = now;
      load().catch((error) => learned.replaceChildren(h("li", { class: "empty" }, error.message)));
      const answer = card("What can somebody learn from this camera?", learned);
      const attacks = card("Privacy card", cardResult(status.bundle.card, "Rows of the card"));
      place.replaceChildren(columns([answer], [leaves(status), masks(status)], [attacks]));
    },
  };
}
