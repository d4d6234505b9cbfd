// Requests to the daemon of this page: the routes that programs use, and no others.

// The page may lie under a path of a proxy, beside other cameras: all is asked from there on.
const BASE = new URL("..", import.meta.url);
const HALF = `veilcam-session${BASE.pathname.slice(0, -1)}`;
// Name of this camera among others: host and port, and the path of a proxy.
export const PLACE = `${location.host}${BASE.pathname.slice(0, -1)}`;
// A stream is silent for no longer than this [ms]; heartbeats come every 30 s at the latest.
const SILENCE = 45000;

export class Problem extends Error {
  constructor({ code, detail, status, retryable }) {
    super(detail);
    Object.assign(this, { code, status, retryable });
  }
}

export class Offline extends Error {
  constructor() {
    super("The daemon does not answer.");
  }
}

// Kept per origin, port included: a page on another port of this host cannot read it.
const half = () => localStorage.getItem(HALF);

// The mode stays that of fetch: in "same-origin" a browser that tells no referrer says Origin: null.
async function send(method, path, { body, type, headers = {}, signal } = {}) {
  const session = half() && !headers.Authorization ? { "Veilcam-Session": half() } : {};
  const media = body === undefined ? {} : { "Content-Type": type ?? "application/json" };
  let answer;
  try {
    answer = await fetch(new URL(path.slice(1), BASE), {
      method,
      body: body === undefined || type ? body : JSON.stringify(body),
      headers: { ...session, ...media, ...headers },
      redirect: "error",
      signal,
    });
  } catch {
    throw new Offline();
  }
  if (answer.ok) return answer;
  let problem;
  try {
    problem = await answer.json();
  } catch {
    // A proxy in front of the daemon answers for it.
    throw new Offline();
  }
  throw new Problem(problem);
}

// Uploads a file; `progress` takes the share that was sent. fetch tells no such share.
export function upload(path, file, type, progress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", new URL(path.slice(1), BASE));
    request.setRequestHeader("Content-Type", type);
    if (half()) request.setRequestHeader("Veilcam-Session", half());
    request.responseType = "json";
    request.upload.addEventListener("progress", ({ loaded, total }) => progress(loaded / total));
    request.addEventListener("load", () => {
      const { status, response } = request;
      if (status < 300 && response) resolve(response);
      else reject(response?.code ? new Problem(response) : new Offline());
    });
    request.addEventListener("error", () => reject(new Offline()));
    request.send(file);
  });
}

export async function ask(method, path, options) {
  const answer = await send(method, path, options);
  return answer.status === 204 ? null : answer.json();
}

// The answer to a POST, and the camera's time of it [ms].
export async function timed(path, body) {
  const sent = await send("POST", path, { body });
  return { answer: await sent.json(), at: Date.parse(sent.headers.get("Date")) || Date.now() };
}

export const get = (path, options) => ask("GET", path, options);
export const post = (path, body, options) => ask("POST", path, { body, ...options });
export const put = (path, body, options) => ask("PUT", path, { body, ...options });
export const remove = (path, options) => ask("DELETE", path, options);

export async function logIn(token) {
  const session = await post("/v1/session", undefined, {
    headers: { Authorization: `Bearer ${token}` },
  });
  localStorage.setItem(HALF, session.half);
  return session;
}

export async function logOut() {
  await remove("/v1/session");
  localStorage.removeItem(HALF);
}

export const forget = () => localStorage.removeItem(HALF);

// Events from `last` on, until the stream ends. Once it is there, and nothing is missed any more, it
// waits for `opened`: its first words come before all that happens from then on.
export async function* events(last, opened) {
  const stop = new AbortController();
  let timer;
  const alive = () => {
    clearTimeout(timer);
    timer = setTimeout(() => stop.abort(), SILENCE);
  };
  alive();
  try {
    const headers = last ? { "Last-Event-ID": last } : {};
    const answer = await send("GET", "/v1/events", { headers, signal: stop.signal });
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let text = "";
    for (let first = true; ; first = false) {
      const { done, value } = await reader.read();
      if (done) return;
      alive();
      if (first) await opened();
      const parts = (text + value).split(/\r?\n\r?\n/);
      text = parts.pop();
      for (const part of parts) {
        const data = part.split(/\r?\n/).filter((line) => line.startsWith("data:"));
        if (data.length) yield JSON.parse(data.map((line) => line.slice(5)).join("\n"));
      }
    }
  } catch (error) {
    throw error instanceof Problem ? error : new Offline();
  } finally {
    clearTimeout(timer);
    stop.abort();
  }
}
