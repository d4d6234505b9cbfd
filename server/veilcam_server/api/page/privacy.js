// Privacy: what leaves the camera, to whom, and what attacks on its masks found.

import { get } from "./api.js";
import { card, columns, empty, h } from "./dom.js";
import { RELEASES, THREATS, day } from "./words.js";

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
    return card(
      "What leaves",
      h("p", {}, RELEASES[release]),
      release === "raw" ? h("p", {}, `At most ${budget} behind one mask.`) : null,
      h("p", { class: "note" }, "No mask and no frame of the sensor ever leaves, here neither."),
    );
  }

  function received({ receivers }) {
    return card(
      "Receivers",
      receivers.length
        ? h(
            "ul",
            { class: "findings" },
            receivers.map((each) =>
              h("li", {}, h("b", {}, each.label), h("span", {}, `since ${day(each.added_at)}`), h("code", {}, each.id.slice(0, 16))),
            ),
          )
        : empty("Nobody is paired: no embedding is sealed to anybody."),
    );
  }

  function attacked({ bundle }) {
    const made = bundle.card;
    if (!made) {
      const text = "These masks have no privacy card: nobody has attacked them, or whoever did wrote no card.";
      return card("Privacy card", empty(text));
    }
    const depth = made.quick ? "a quick card, of few masks and light attackers" : "a full card";
    return card(
      "Privacy card",
      h("p", { class: "big" }, made.outcome),
      h("p", { class: "note" }, `Of masks “${made.mode}”, embeddings ${made.form}; ${depth}, made ${day(made.made_at)}.`),
      h(
        "div",
        { class: "scroll", tabindex: "0", role: "region", "aria-label": "Rows of the card" },
        h(
          "table",
          {},
          h("thead", {}, h("tr", {}, ["Threat", "Outcome", "Reached", "At most"].map((text) => h("th", { scope: "col" }, text)))),
          h(
            "tbody",
            {},
            made.rows.map((row) =>
              h(
                "tr",
                {},
                h("th", { scope: "row" }, `${row.threat} ${THREATS[row.threat] ?? ""}`),
                h("td", {}, row.outcome),
                h("td", {}, `${row.figure} ${row.unit}`),
                h("td", {}, `${row.end} ${row.unit}`),
              ),
            ),
          ),
        ),
      ),
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
      h("dl", { class: "facts" }, pairs.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value)))),
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
      place.replaceChildren(columns([answer], [leaves(status), received(status), masks(status)], [attacked(status)]));
    },
  };
}
