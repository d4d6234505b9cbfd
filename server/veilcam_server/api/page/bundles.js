// Bundles: the one in use, an upload that is checked before it is used, and the way back.

import { get, post, remove, upload } from "./api.js";
import { button, card, columns, confirmed, empty, facts, field, fold, form, h, say } from "./dom.js";
import { cardResult } from "./privacy.js";

const MEDIA_TYPE = "application/vnd.veilcam.bundle";

const named = ({ digest, bundle }) =>
  `${bundle?.task ?? "damaged"}${bundle?.version ? ` version ${bundle.version}` : ""}, ${digest.slice(0, 8)}`;

function contents({ bundle, size, configured }) {
  if (!bundle) return [empty("This file is damaged on the disk.")];
  const hides = bundle.hiding?.found ?? ["Nobody measured what its masks hide."];
  const label = `Rows of the card of ${bundle.digest.slice(0, 8)}`;
  return [
    facts([
      ["Labels", bundle.labels.join(", ")],
      ["Masks", bundle.mode === "fresh" ? "a new one for every epoch" : `${bundle.pairs} that take turns`],
      ["Signed by", bundle.signed_by ?? "nobody"],
      ["Size", `${(size / 1e6).toFixed(1)} MB`],
      ["Came", configured ? "with the start of the daemon" : "by upload"],
    ]),
    fold("What its masks give away", h("ul", { class: "findings" }, hides.map((text) => h("li", {}, h("span", {}, text))))),
    fold(`Privacy card: ${bundle.card?.outcome ?? "none"}`, cardResult(bundle.card, label)),
  ];
}

export function bundlesView(camera) {
  const place = h("div", { class: "column" });
  const used = h("div", { class: "column" });
  const told = h("p", { class: "note", role: "status" }, "A file is checked first, and changes nothing yet.");
  const bar = h("progress", { max: "1", value: "0", "aria-label": "Share that is sent" });
  const file = h("input", { name: "bundle", type: "file", accept: ".veilcam", required: true });
  let active = null;
  let before = null;

  // `older` is asked for only where the daemon says so.
  async function activate(each, older = "") {
    try {
      await post(`/v1/bundles/${each.digest}/activate${older}`);
    } catch (error) {
      if (error.code !== "bundle_older" || older) throw error;
      if (!(await confirmed("Its version is older than the one in use. Use it all the same?", "Use it"))) return;
      return activate(each, "?allow_older=true");
    }
    say(told, `${named(each)} is in use from now on.`);
    await Promise.all([load(), camera.refresh()]);
  }

  async function load() {
    const { bundles } = await get("/v1/bundles");
    const now = bundles.find((each) => each.active);
    if (active && active !== now.digest) before = active;
    active = now.digest;
    const others = bundles.filter((each) => !each.active);
    // The one before, or else the one that the daemon was started with.
    const back = others.find((each) => each.digest === before) ?? others.find((each) => each.configured);
    used.replaceChildren(
      card(
        "In use",
        h("p", { class: "big" }, named(now)),
        contents(now),
        back ? h("p", { class: "row" }, button(`Go back to ${named(back)}`, () => activate(back), { plain: true })) : null,
      ),
    );
    place.replaceChildren(...others.map(other));
    if (!others.length) place.replaceChildren(card("Others", empty("There is no other bundle on this camera.")));
  }

  function other(each) {
    const drop = button("Remove", async () => {
      if (!(await confirmed(`Remove ${named(each)} for good?`, "Remove"))) return;
      await remove(`/v1/bundles/${each.digest}`);
      await load();
    }, { plain: true, "aria-label": `Remove ${named(each)}` });
    const use = button("Activate", () => activate(each), { "aria-label": `Activate ${named(each)}` });
    const read = contents(each);
    // What is not in use yet is to be read before it is.
    for (const part of read) if (part.matches("details")) part.open = true;
    return card(named(each), read, h("p", { class: "row" }, each.bundle ? use : null, each.configured ? null : drop));
  }

  const send = form(
    {},
    async () => {
      const [chosen] = file.files;
      bar.value = 0;
      say(told, `Sending ${chosen.name}.`);
      try {
        const found = await upload("/v1/bundles", chosen, MEDIA_TYPE, (share) => {
          bar.value = share;
          if (share === 1) say(told, "It is being checked.");
        });
        say(told, `${named(found)} can be used here. Read its card, then activate it.`);
      } catch (error) {
        say(told, "Nothing was changed.");
        throw error;
      }
      await load();
    },
    field("A file *.veilcam", file),
    bar,
    h("button", { type: "submit" }, "Upload"),
  );
  load().catch((error) => place.replaceChildren(empty(error.message)));
  return {
    elements: [columns([card("Upload a bundle", send, told), used], [place])],
    update(event) {
      if (event?.kind === "bundle") load().catch(() => {});
    },
  };
}
