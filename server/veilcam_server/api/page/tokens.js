// Tokens: who may ask this camera, and for what.

import { get, post, remove } from "./api.js";
import { button, card, columns, confirmed, empty, field, form, h, say } from "./dom.js";
import { SCOPES, day } from "./words.js";

const DAY = 86400;

export function tokensView(camera) {
  const place = h("div", {});
  const secret = h("div", { "aria-live": "polite" });

  async function load() {
    const found = [];
    for (let after = null; ;) {
      const page = await get(`/v1/tokens${after ? `?after=${after}` : ""}`);
      found.push(...page.tokens);
      after = page.next;
      if (after === null) break;
    }
    place.replaceChildren(list(found.filter((token) => !token.revoked_at)));
  }

  function list(tokens) {
    if (!tokens.length) return empty("There is none.");
    return h(
      "ul",
      { class: "findings" },
      tokens.map((token) =>
        h(
          "li",
          {},
          h("b", {}, token.label),
          h("span", {}, token.scopes.join(", ")),
          h("span", { class: "note" }, told(token)),
          button("Revoke", async () => {
            if (!(await confirmed(`Revoke the token “${token.label}”? Who has it is out at once.`, "Revoke"))) return;
            await remove(`/v1/tokens/${token.id}`);
            await load();
          }, { plain: true, "aria-label": `Revoke ${token.label}` }),
        ),
      ),
    );
  }

  function told(token) {
    const ends = token.expires_at ? `ends ${day(token.expires_at)}` : "does not end";
    return `${ends}, ${token.last_used_on ? `last used ${token.last_used_on}` : "not used yet"}`;
  }

  function make() {
    const label = h("input", { name: "label", required: true, maxlength: "64", pattern: "[ -~]+", autocomplete: "off" });
    const days = h("input", { name: "days", type: "number", min: "1", max: "3660", placeholder: "no end" });
    const scopes = Object.entries(SCOPES).filter(([scope]) => camera.may(scope));
    return form(
      {},
      async (values) => {
        const chosen = values.getAll("scope");
        if (!chosen.length) throw new Error("Choose what it allows.");
        const lasts = values.get("days") ? { seconds: Number(values.get("days")) * DAY } : {};
        const made = await post("/v1/tokens", { label: values.get("label"), scopes: chosen, ...lasts });
        const copied = h("p", { class: "note", role: "status" });
        secret.replaceChildren(
          h("p", {}, "This is the token. It is shown this once:"),
          h("p", { class: "secret" }, h("code", {}, made.secret)),
          h(
            "p",
            { class: "row" },
            button("Copy it", async () => {
              await navigator.clipboard.writeText(made.secret);
              say(copied, "Copied.");
            }),
            button("Done", async () => secret.replaceChildren(), { plain: true }),
          ),
          copied,
        );
        await load();
      },
      field("For whom or what", label),
      field("Days that it lasts", days, "Empty: until it is revoked."),
      h(
        "fieldset",
        {},
        h("legend", {}, "What it allows"),
        scopes.map(([scope, text]) =>
          h(
            "label",
            { class: "check" },
            h("input", { type: "checkbox", name: "scope", value: scope, checked: scope === "read:status" }),
            h("span", {}, h("code", {}, scope), ` ${text}`),
          ),
        ),
      ),
      h("button", { type: "submit" }, "Make it"),
    );
  }

  if (!camera.session.tokens) {
    const text = "This daemon wants no tokens: who reaches it may use it. Start it with --auth tokens to have some.";
    return { elements: [card("Tokens", empty(text))], update() {} };
  }
  if (!camera.may("admin:tokens")) {
    return { elements: [card("Tokens", empty("This token may not see or make tokens."))], update() {} };
  }
  load().catch((error) => place.replaceChildren(empty(error.message)));
  return {
    elements: [columns([card("Who may ask", place)], [card("Make a token", make(), secret)])],
    update() {},
  };
}
