// Tokens: who may ask this camera, and for what.

import { get, post, remove } from "./api.js";
import { button, card, columns, confirmed, empty, field, fold, form, h, pick, secretLine } from "./dom.js";
import { ROLES, SCOPES, day } from "./words.js";

const DAY = 86400;

export function tokensView(camera) {
  const place = h("div", {});
  const secret = h("section", { class: "card", "aria-label": "New token", "aria-live": "polite", hidden: true });

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
          h("span", {}, token.role ?? "scopes of its own"),
          h("span", { class: "note" }, told(token)),
          fold("Scopes", h("code", {}, token.scopes.join(", "))),
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
        const scopes = values.getAll("scope");
        const allowed = scopes.length ? { scopes } : { role: values.get("role") };
        const lasts = values.get("days") ? { seconds: Number(values.get("days")) * DAY } : {};
        const made = await post("/v1/tokens", { label: values.get("label"), ...allowed, ...lasts });
        const { elements, copy } = secretLine(made.secret, "This is the token. It is shown this once:");
        const done = button("Done", async () => {
          secret.replaceChildren();
          secret.hidden = true;
        }, { plain: true });
        secret.replaceChildren(h("h2", {}, `Token of ${made.label}`), ...elements, h("p", { class: "row" }, copy, done));
        await load();
        secret.hidden = false;
        secret.scrollIntoView({ block: "nearest" });
      },
      field("For whom or what", label),
      field("Days that it lasts", days, "Empty: until it is revoked."),
      pick("Role", "role", "viewer", Object.entries(ROLES).map(([role, text]) => [role, role, text])),
      fold(
        "Scopes",
        h("p", { class: "note" }, "For a program. If any is chosen, they take the place of the role."),
        scopes.map(([scope, text]) =>
          h("label", { class: "check" }, h("input", { type: "checkbox", name: "scope", value: scope }), h("span", {}, h("code", {}, scope), ` ${text}`)),
        ),
      ),
      h("button", { type: "submit" }, "Make token"),
    );
  }

  if (!camera.session.tokens) {
    const text = "This daemon wants no tokens: who reaches it may use it. Start it with --auth tokens to have some.";
    return { elements: [card("Tokens", empty(text))], update() {} };
  }
  load().catch((error) => place.replaceChildren(empty(error.message)));
  return {
    elements: [columns([card("Make a token", make())], [card("Tokens of this camera", place), secret])],
    update() {},
  };
}
