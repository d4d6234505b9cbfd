// The page: logs in, follows what happens, and shows one view at a time.

import { Offline, PLACE, Problem, events, forget, get, logIn, logOut } from "./api.js";
import { bundlesView } from "./bundles.js";
import { calibrationView } from "./calibration.js";
import { button, card, empty, field, form, h, say } from "./dom.js";
import { OFTEN, eventsView } from "./events.js";
import { healthView } from "./health.js";
import { createMemory } from "./history.js";
import { liveView } from "./live.js";
import { logView } from "./log.js";
import { privacyView } from "./privacy.js";
import { receiversView } from "./receivers.js";
import { tokensView } from "./tokens.js";
import { changes, withChange } from "./sights.js";
import { STATES } from "./words.js";

const KEPT = 200;
const KEPT_OFTEN = 40;
// Title, view, and the scope without which it is of no use.
const VIEWS = {
  live: ["Live", liveView],
  health: ["Health", healthView],
  receivers: ["Receivers", receiversView],
  bundles: ["Bundles", bundlesView, "admin:bundles"],
  calibrate: ["Calibrate", calibrationView, "calibrate"],
  tokens: ["Tokens", tokensView, "admin:tokens"],
  privacy: ["Privacy", privacyView],
  events: ["Events", eventsView],
  log: ["Log", logView, "read:log"],
};
// Looks are counted so often [ms], at fixed times: when it asks says nothing of what is seen.
const COUNTED = 2000;
// After these events the status is another one, or what it sees is.
const TELLING = new Set(["state", "mask", "rotation", "bundle", "calibration", "capture", "gap"]);
const WATCHED = new Set(["watch", "gap"]);

const main = document.getElementById("main");
const nav = document.getElementById("views");
const notice = document.getElementById("notice");
const pill = document.getElementById("state");

// What the views share: who asks, the status, and what happened since the page was opened.
const NOTHING = { session: null, status: null, statusAt: 0, watch: null, events: [], memory: null };
const camera = {
  ...NOTHING,
  may: (scope) => camera.session.scopes.includes(scope),
  refresh,
};
let shown = null;
let stale = false;
let asked = 0;
let told = 0;
let counted = 0;
let leaving = false;
say(document.getElementById("place"), PLACE);

async function refresh() {
  asked += 1;
  const number = asked;
  stale = false;
  let status, watch;
  try {
    [status, watch] = await Promise.all([get("/v1/status"), watched()]);
  } catch (error) {
    stale = true;
    throw error;
  }
  // What a later question was answered is newer, and who logged out is told nothing.
  if (number < told || !camera.session) return;
  told = number;
  Object.assign(camera, { status, watch, statusAt: performance.now() });
  if (watch) camera.memory.count(watch.looks);
  update();
}

async function watched() {
  try {
    return await get("/v1/watch");
  } catch (error) {
    if (error.code === "not_enabled") return null;
    throw error;
  }
}

function update(event = null) {
  const { state } = camera.status;
  say(pill, STATES[state] ?? state);
  pill.dataset.well = state === "ready" || state === "replay";
  if (camera.watch?.activity === "looking") camera.memory.note(camera.watch.belief?.label ?? null);
  shown?.update(event);
}

function warn(text) {
  say(notice, text);
  notice.hidden = text === "";
  document.body.classList.toggle("offline", text !== "");
}

function take(event) {
  if (event.kind === "belief") {
    // What is seen is told, and nothing is asked for: who listens learns nothing from that.
    for (const each of changes(camera.watch?.history[0], event)) take(each);
    if (camera.watch) {
      const { belief } = camera.watch;
      if (event.belief && belief && event.belief.looks > belief.looks) camera.memory.looked();
      camera.watch.belief = event.belief;
    }
    update(event);
    return;
  }
  camera.watch = withChange(camera.watch, event);
  // What comes often does not push out the rest.
  const often = OFTEN.has(event.kind);
  const alike = camera.events.filter((each) => OFTEN.has(each.kind) === often);
  if (alike.length >= (often ? KEPT_OFTEN : KEPT)) {
    camera.events.splice(camera.events.lastIndexOf(alike.at(-1)), 1);
  }
  camera.events.unshift(event);
  if (event.kind === "state") camera.status.state = event.state;
  if (event.kind === "classification") {
    camera.memory.looked();
    if (camera.watch?.activity !== "looking") {
      camera.memory.note(event.label, Date.now(), Date.now() + 1000);
      camera.memory.pause();
    }
  }
  if (TELLING.has(event.kind)) stale = true;
  if (WATCHED.has(event.kind)) refresh().catch(() => {});
  else update(event);
}

// Follows the daemon until the session ends, through its restarts. What happened before it listens
// the status tells, so that is asked for once it listens, and not before.
async function follow() {
  let last = null;
  for (let failures = 0; ; failures += 1) {
    const begun = performance.now();
    try {
      const heard = events(last, async () => {
        await refresh();
        warn("");
        main.removeAttribute("aria-busy");
      });
      for await (const event of heard) {
        if (event.id) last = event.id;
        take(event);
      }
    } catch (error) {
      if (error instanceof Problem && error.status === 401) {
        if (!leaving) ended();
        return;
      }
      main.setAttribute("aria-busy", "true");
      camera.memory.pause();
      if (error instanceof Problem && error.status < 500) warn(error.message);
      else warn("The daemon does not answer. This page goes on as soon as it does.");
    }
    if (performance.now() - begun > 5000) failures = 0;
    await new Promise((resolve) => setTimeout(resolve, Math.min(5000, 250 * 2 ** failures)));
  }
}

// Times go by; and what an event made stale is fetched anew, once a second at most.
setInterval(() => {
  if (!camera.status || !shown) return;
  const due = performance.now() - counted >= COUNTED;
  if (due) counted = performance.now();
  if ((stale || due) && !document.hidden) refresh().catch(() => {});
  else shown.tick?.();
}, 1000);

function show() {
  const wanted = location.hash.slice(1);
  const name = Object.hasOwn(VIEWS, wanted) ? wanted : "live";
  const [title, make, scope] = VIEWS[name];
  shown?.close?.();
  shown = !scope || camera.may(scope) ? make(camera) : refused(title, scope);
  document.title = `${title}: ${PLACE}, Veilcam`;
  for (const link of nav.querySelectorAll("a")) {
    if (link.hash === `#${name}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  main.replaceChildren(h("h1", {}, title), ...shown.elements);
  shown.update(null);
}

function refused(title, scope) {
  const text = `This needs a token of an owner; yours lacks the scope ${scope}.`;
  return { elements: [card(title, empty(text))], update() {} };
}

addEventListener("hashchange", () => {
  if (!camera.session) return;
  show();
  main.focus();
  scrollTo(0, 0);
});

async function begin(session) {
  Object.assign(camera, { session, memory: createMemory() });
  main.setAttribute("aria-busy", "true");
  await refresh();
  nav.replaceChildren(
    ...Object.entries(VIEWS)
      .filter(([, [, , scope]]) => !scope || camera.may(scope))
      .map(([name, [title]]) => h("a", { href: `#${name}` }, title)),
  );
  if (session.tokens) {
    nav.append(button("Log out", leave, { plain: true }));
  }
  nav.hidden = false;
  show();
  follow();
}

// The page is loaded anew, so that its memory keeps nothing of the session.
async function leave() {
  leaving = true;
  try {
    await logOut();
    location.reload();
  } catch (error) {
    leaving = false;
    throw error;
  }
}

function ended() {
  forget();
  showLogIn("This session has ended. Give the token again to go on.");
}

function showLogIn(reason = "") {
  // Who logs in next is told nothing of what the one before saw.
  Object.assign(camera, NOTHING, { events: [] });
  main.removeAttribute("aria-busy");
  shown?.close?.();
  shown = null;
  nav.hidden = true;
  say(pill, "");
  document.title = `Log in: ${PLACE}, Veilcam`;
  warn("");
  const token = h("input", {
    name: "token", type: "password", autocomplete: "current-password", required: true, spellcheck: "false",
  });
  main.replaceChildren(
    h("h1", {}, "Log in"),
    card(
      `Camera ${PLACE}`,
      reason ? h("p", { role: "alert" }, reason) : null,
      form(
        {},
        async (values) => {
          const given = values.get("token").trim();
          if (!/^[\x21-\x7e]+$/.test(given)) throw new Error("This is no token.");
          let session;
          try {
            session = await logIn(given);
          } catch (error) {
            if (error.status !== 401) throw error;
            throw new Error("This token is not known here, or it has ended.");
          }
          await begin(session);
          main.focus();
        },
        field(
          "Token",
          token,
          [
            "The owner of this camera makes one on the page, under Tokens. The first one is made on the camera, by ",
            h("code", {}, "sudo veilcamd token first"),
            ". It is not kept in this browser.",
          ],
        ),
        h("button", { type: "submit" }, "Log in"),
      ),
    ),
  );
  token.focus();
}

async function open() {
  for (;;) {
    try {
      await begin(await get("/v1/session"));
      warn("");
      return;
    } catch (error) {
      if (error instanceof Problem && error.status === 401) {
        showLogIn();
        return;
      }
      warn(error instanceof Offline ? `${error.message} This page goes on as soon as it does.` : error.message);
      await new Promise((resolve) => setTimeout(resolve, 2000));
    }
  }
}

open();
