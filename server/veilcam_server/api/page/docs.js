// The API as a page: the OpenAPI document of this daemon, one card for each subject.

import { Problem, get } from "./api.js";
import { card, facts, fold, h, say } from "./dom.js";

const main = document.getElementById("main");
const notice = document.getElementById("notice");
const index = document.getElementById("index");
const WIDE = matchMedia("(min-width: 56rem)");
const READ = 96; // An operation is read once its top is so near to the window's [px].
const METHODS = ["get", "put", "post", "delete"];

// Only what this document has: code between backquotes, and plain text.
function prose(text) {
  return text.split(/`+([^`]+)`+/).map((part, index) => (index % 2 ? h("code", {}, part) : part));
}

// Code that is wider than a phone is scrolled, with the keyboard too.
const code = (text, label) => h("pre", { tabindex: "0", role: "region", "aria-label": label }, h("code", {}, text));

function example(content) {
  for (const { example: one, examples } of Object.values(content ?? {})) {
    if (one !== undefined) return one;
    const [first] = Object.values(examples ?? {});
    if (first) return JSON.stringify(first.value, null, 2);
  }
  return null;
}

function operation(method, path, found) {
  const scopes = (found.security ?? []).flatMap((each) => Object.values(each).flat());
  const [good] = Object.entries(found.responses).filter(([status]) => status.startsWith("2"));
  const answer = example(good?.[1].content);
  const asked = example(found.requestBody?.content);
  const name = `${method.toUpperCase()} ${path}`;
  return h(
    "article",
    { class: "operation", id: found.operationId, "aria-labelledby": `${found.operationId}-name` },
    h("h3", { id: `${found.operationId}-name` }, h("code", { class: "method" }, method.toUpperCase()), " ", h("code", {}, path)),
    found.description.split("\n\n").map((text) => h("p", {}, prose(text.replaceAll("\n", " ")))),
    h("p", { class: "note" }, scopes.length ? ["Wants ", h("code", {}, scopes.join(", "))] : "Wants no token."),
    parameters(found.parameters ?? []),
    asked && h("p", { class: "note" }, "It is asked with"),
    asked && code(asked, `Body of ${name}`),
    (found["x-codeSamples"] ?? []).map(({ lang, source }) => code(source, `${lang} for ${name}`)),
    answer && h("p", { class: "note" }, `It answers ${good[0]}`),
    answer && code(answer, `Answer of ${name}`),
    problems(found.responses),
  );
}

function parameters(found) {
  if (!found.length) return null;
  return facts(found.map((each) => [h("code", {}, each.name), `${each.in}${each.required ? ", required" : ""}`]));
}

function problems(responses) {
  const bad = Object.entries(responses).filter(([status]) => status >= "400");
  return fold("What can go wrong", facts(bad.map(([status, { description }]) => [status, description])));
}

function draw(found) {
  const subjects = new Map(found.tags.map(({ name, description }) => [name, { description, operations: [] }]));
  for (const [path, operations] of Object.entries(found.paths)) {
    for (const method of METHODS.filter((each) => each in operations)) {
      const { tags } = operations[method];
      subjects.get(tags[0]).operations.push(operation(method, path, operations[method]));
    }
  }
  main.replaceChildren(
    h("h1", {}, `The API, version ${found.info.version}`),
    ...[...subjects].map(([name, { description, operations }]) => {
      const made = card(name, h("p", { class: "note" }, prose(description)), operations);
      made.classList.add("wide", "subject");
      return made;
    }),
  );
}

// A list of all operations by subject: beside the text, or folded above it where there is no room.
function list() {
  const groups = [...main.querySelectorAll(".subject")].map((subject) => [
    h("h2", {}, subject.querySelector("h2").textContent),
    h("ul", {}, [...subject.querySelectorAll("article")].map(({ id }) => {
      const [method, path] = document.querySelectorAll(`#${id} h3 code`);
      return h("li", {}, h("a", { href: `#${id}` }, h("span", {}, method.textContent), " ", path.textContent));
    })),
  ]);
  const folded = fold("Operations", groups.flat());
  folded.open = WIDE.matches;
  WIDE.addEventListener("change", () => { folded.open = WIDE.matches; });
  index.replaceChildren(folded);
  addEventListener("scroll", follow, { passive: true });
  document.getElementById(location.hash.slice(1))?.scrollIntoView();
  follow();
}

// Marks the operation that is read. What stands last cannot come up to the top: there the chosen one counts.
function follow() {
  const all = [...main.querySelectorAll("article")];
  const read = all.findLast((each) => each.getBoundingClientRect().top <= READ) ?? all[0];
  const ends = innerHeight + scrollY >= document.documentElement.scrollHeight - 1;
  const below = ends ? all.slice(all.indexOf(read) + 1) : [];
  const { id } = below.find((each) => location.hash === `#${each.id}`) ?? below.at(-1) ?? read;
  const link = index.querySelector(`[href="#${id}"]`);
  const before = index.querySelector("[aria-current]");
  if (link === before) return;
  before?.removeAttribute("aria-current");
  link.setAttribute("aria-current", "true");
  // The list alone is moved, where it stands beside the text.
  if (WIDE.matches) index.scrollTop = link.offsetTop - index.clientHeight / 2;
}

async function open() {
  try {
    draw(await get("/v1/openapi.json"));
    list();
  } catch (error) {
    main.replaceChildren(h("h1", {}, "The API"));
    notice.hidden = false;
    if (error instanceof Problem && error.status === 401) {
      notice.replaceChildren("Log in to read it: ", h("a", { href: "./" }, "the camera"));
    } else say(notice, error.message);
  }
}

open();
