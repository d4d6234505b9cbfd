// Live: what the camera sees, the mask, the embedding, and on a simulator the scene.

import { post, put } from "./api.js";
import { button, card, columns, empty, facts, field, fold, form, h, pick, say } from "./dom.js";
import { pictureOf } from "./embedding.js";
import { historyCard } from "./history.js";
import { sceneCards } from "./scene.js";
import { activityText, duration, isOpaque, isResting, next, policyText, sureText } from "./words.js";

// A recording has no watch of its own.
const REPLAYED = { activity: "on_request", detail: null, policy: {} };

export function liveView(camera) {
  const groups = [
    [labelCard(camera), ...(camera.may("classify") ? [historyCard(camera)] : [])],
    [maskCard(camera), ...(camera.may("read:embedding") ? [embeddingCard(camera)] : [])],
    sceneCards(camera),
  ];
  const parts = groups.flat();
  const each = (name) => (event) => parts.forEach((part) => part[name]?.(event));
  return {
    elements: [columns(...groups.map((group) => group.map((part) => part.element)))],
    update: each("update"),
    tick: each("tick"),
  };
}

function labelCard(camera) {
  const label = h("output", { class: "label", "aria-live": "polite" });
  const since = h("p", {});
  const how = h("p", { class: "note", role: "status" });
  const [rate, last, captures] = ["", "", ""].map(() => h("span", {}));
  let asked = null;
  const look = button("Look once", async () => {
    asked = await post("/v1/classifications");
    draw();
  });

  // By itself it believes; where it is asked, it says what that one look gave.
  function present() {
    if (isOpaque(camera)) return null;
    const belief = camera.watch?.belief;
    if (belief) return { ...belief, at: belief.since };
    const [newest] = camera.events.filter((event) => event.kind === "classification");
    // The answer may be here before its event.
    if (asked && (!newest || new Date(newest.at) < new Date(asked.taken_at))) {
      return { ...asked, at: asked.taken_at };
    }
    if (!newest) return null;
    const own = asked?.id.startsWith(newest.capture) ? asked : null;
    return { label: newest.label, confidence: own?.confidence ?? null, at: newest.at };
  }

  function draw() {
    const { activity, detail, policy } = camera.watch ?? REPLAYED;
    const now = present();
    const word = now === null ? "–" : (now.label ?? "Nothing that it knows");
    say(label, camera.may("classify") ? word : "This token may not see labels");
    label.classList.toggle("none", !now?.label);
    label.dataset.sure = now?.label ? sureText(now.confidence) : "";
    say(how, activityText(activity, detail, policy));
    look.hidden = isResting(camera.watch);
    tick();
  }

  function tick() {
    say(since, told());
    const { memory, status, watch } = camera;
    const looks = watch?.looks ?? 0;
    const found = memory.rate();
    say(rate, found === null ? "–" : found.toFixed(found < 1 ? 2 : 1));
    say(last, memory.lookedAt ? `${duration((performance.now() - memory.lookedAt) / 1000)} ago` : "–");
    say(captures, `${status.captures + looks}${looks ? ` (${looks} by itself)` : ""}`);
  }

  function told() {
    const now = present();
    if (!camera.may("classify")) return "";
    if (isOpaque(camera)) return "The panel is opaque: the camera sees nothing.";
    if (!now) return camera.memory.heard.length ? "It sees nothing now." : "Nothing was seen yet.";
    const time = duration((Date.now() - new Date(now.at)) / 1000);
    const sure = [sureText(now.label ? now.confidence : null), camera.watch?.belief ? `for ${time}` : `${time} ago`];
    return sure.filter(Boolean).join(", ");
  }

  return {
    element: card(
      "It sees",
      h("div", { class: "seen" }, label, since),
      camera.may("classify") ? h("p", { class: "row" }, look) : null,
      how,
      camera.may("classify")
        ? facts([["Looks a second, last minute", rate], ["Last look", last], ["Captures in total", captures]])
        : null,
      camera.may("mask:rotate") && camera.watch ? watchForm(camera) : null,
    ),
    update: draw,
    tick,
  };
}

function watchForm(camera) {
  const { policy } = camera.watch;
  const rate = h("input", {
    name: "rate", type: "number", min: "0.001", max: "10", step: "any", required: true, value: String(policy.rate_hz ?? 2),
  });
  const [begin, end] = ["begin", "end"].map((name) =>
    h("input", { name, type: "time", value: policy.quiet?.[name] ?? "" }),
  );
  const rateField = field("Looks per second", rate);
  const hours = h("div", { class: "row" }, field("From", begin), field("To", end));
  const quiet = h("fieldset", {}, h("legend", {}, "Quiet hours, with an opaque panel"), hours);
  const adapt = (mode) => {
    rateField.hidden = mode !== "watching";
    rate.disabled = rateField.hidden;
    quiet.hidden = mode === "off";
  };
  adapt(policy.mode);
  const options = [["watching", "By itself"], ["on_request", "When asked"], ["off", "Not at all", "The panel is opaque."]];
  return fold(
    "When it looks",
    form(
      {},
      async (values) => {
        const chosen = values.get("mode");
        const hours = { begin: values.get("begin"), end: values.get("end") };
        if (Boolean(hours.begin) !== Boolean(hours.end)) throw new Error("Give both times, or none.");
        await put("/v1/watch", {
          mode: chosen,
          ...(chosen === "watching" ? { rate_hz: Number(values.get("rate")) } : {}),
          ...(chosen === "off" ? {} : { quiet: hours.begin ? hours : null }),
        });
        await camera.refresh();
      },
      pick("It looks", "mode", policy.mode, options, adapt),
      rateField,
      quiet,
      h("button", { type: "submit", class: "plain" }, "Apply"),
    ),
  );
}

function maskCard(camera) {
  const epoch = h("p", { class: "note" });
  const picture = h("img", {
    src: new URL("lensless.svg", import.meta.url).href, width: "320", height: "96", class: "lensless",
    alt: "A scene, the mask that its light passes, and the numbers that leave",
  });
  const bar = h("progress", { max: "1", "aria-label": "Until the next mask" });
  const due = h("p", {});
  const change = button("Change mask", async () => {
    await post("/v1/rotation/advance");
    await camera.refresh();
  });

  function tick() {
    const passed = (performance.now() - camera.statusAt) / 1000;
    const { rotation } = camera.status;
    const age = (rotation.epoch_age_s ?? 0) + passed;
    const { text, share } = next({ ...rotation, epoch_age_s: age });
    say(due, text);
    change.hidden = isResting(camera.watch);
    bar.value = share;
    const name = rotation.epoch?.slice(0, 8);
    say(epoch, name ? `Epoch ${name}, shown for ${duration(age)}` : "The panel is opaque");
  }

  return {
    element: card(
      "Mask",
      h("figure", {}, picture, h("figcaption", { class: "note" }, "No lens: light of the scene passes the mask, and the sensor sees numbers, no picture.")),
      due,
      bar,
      camera.may("mask:rotate") ? h("p", { class: "row" }, change) : null,
      epoch,
      camera.may("mask:rotate") ? policyForm(camera) : null,
    ),
    update: tick,
    tick,
  };
}

function policyForm(camera) {
  const { policy } = camera.status.rotation;
  const count = h("input", {
    name: "count", type: "number", min: "1", max: "86400", required: true, value: String(policy.captures ?? policy.seconds ?? 10),
  });
  const told = h("p", { class: "note", role: "status" });
  const amount = field("How many", count);
  const adapt = (mode) => {
    amount.hidden = mode === "off";
    count.disabled = amount.hidden;
    count.step = mode === "seconds" ? "any" : "1";
  };
  adapt(policy.mode);
  const options = [["captures", "After so many captures"], ["seconds", "Every so many seconds"], ["off", "By hand alone"]];
  return fold(
    "When masks change",
    form(
      {},
      async (values) => {
        const chosen = values.get("mode");
        const amounts = chosen === "off" ? {} : { [chosen]: Number(values.get("count")) };
        const rotation = await put("/v1/rotation", { mode: chosen, ...amounts });
        say(told, `From now on: ${policyText(rotation.policy)}.`);
        await camera.refresh();
      },
      pick("Masks change", "mode", policy.mode, options, adapt),
      amount,
      h("button", { type: "submit", class: "plain" }, "Apply"),
      told,
    ),
  );
}

function embeddingCard(camera) {
  const place = h("div", { class: "picture" });
  const told = h("p", { class: "note" });
  const none = empty("None taken yet. This is all that leaves the camera of a scene.");
  const take = button("Take one", async () => {
    const capture = await post("/v1/captures");
    none.hidden = true;
    const { embedding } = capture;
    if (embedding.form === "sealed") {
      place.replaceChildren();
      say(told, "It left sealed: only the receivers that are paired can open it.");
      return;
    }
    place.replaceChildren(pictureOf(embedding));
    const size = embedding.shape.join(" × ");
    say(told, `${size} numbers, ${embedding.form}, behind epoch ${capture.epoch.slice(0, 8)}.`);
  });
  return {
    element: card("Embedding", none, place, told, h("p", { class: "row" }, take)),
    update() {
      const kept = camera.status.release === "none";
      take.hidden = kept || isResting(camera.watch);
      if (kept) say(none, "Embeddings stay in the camera: labels alone leave.");
    },
  };
}
