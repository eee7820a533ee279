// The History screen: one day of the store at a time; moments of this run open in replay.
import { get } from "./board.js";
import { M_PER_FT, appeared, distance, element, plusMinus, units } from "./format.js";

const about = JSON.parse((await appeared("qt-history")).dataset.about);
const by = (id) => document.getElementById(id);
const canvas = by("qt-day");
const COLOURS = { clear: "--clear", queued: "--queued", beyond_view: "--beyond", unknown: "--unknown" };
const STRIP = { clear: [6, 6], queued: [0, 12], beyond_view: [0, 12], unknown: [10, 2] };
const NAMES = { clear: "clear", queued: "queued", beyond_view: "queue ends beyond view", unknown: "unknown" };
let rows = [], flights = [], run = null;

const pad = (n) => `${n}`.padStart(2, "0");
const dayOf = (date) => `${date.getFullYear()}-${pad(date.getMonth() + 1)}-${pad(date.getDate())}`;
const clock = (utc) => new Date(utc).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit" });
const span = () => {
  const begin = new Date(`${by("qt-date").value}T00:00:00`);
  return [begin, new Date(begin.getFullYear(), begin.getMonth(), begin.getDate() + 1)];
};
const say = (words) => { by("qt-said").textContent = words; };
const query = () => {
  const [since, until] = span(), flight = by("qt-flight").value;
  return `since=${since.toISOString()}&until=${until.toISOString()}${flight ? `&flight=${encodeURIComponent(flight)}` : ""}`;
};

// The run that is open here: its own answers, with the moment in replay of each.
async function ownRun() {
  const { rows: own } = await get("/api/v1/history?limit=4000");
  if (own.length) run = { rows: own, begin: new Date(own[0].utc) - own[0].t_s * 1000 };
}
const replay = (row) => {
  if (about.live || !run) return null;
  const t_s = row.own ? row.t_s : (new Date(row.utc) - run.begin) / 1000;
  const last = run.rows.at(-1).t_s;
  return t_s >= -1 && t_s <= last + 1 ? `/?t=${Math.max(t_s, 0).toFixed(2)}` : null;
};

async function refresh() {
  by("qt-flights").setAttribute("aria-busy", "true");
  const [since, until] = span();
  const wanted = by("qt-flight").value;
  say("");
  let events = [];
  try {
    const found = await get(`/api/v1/flights?since=${since.toISOString()}&until=${until.toISOString()}`);
    flights = found.flights;
    if (found.problem) say(found.problem);
    if (flights.length) {
      rows = (await get(`/api/v1/flights/eoq?${query()}`)).rows;
      events = (await get(`/api/v1/flights/events?${query()}`)).rows;
    } else rows = [];
  } catch (error) {
    say(error.message);
    flights = rows = [];
  }
  if (!flights.length && run && dayOf(new Date(run.begin)) === by("qt-date").value) {
    rows = run.rows.map((r) => ({ ...r, own: true, flight: "" }));
    events = changes(rows);
    if (!about.live) say("The store knows nothing of this day: shown is the run that is open.");
  }
  by("qt-flight").replaceChildren(element("option", { value: "" }, "all of the day"),
    ...flights.map((f) => element("option", { value: f.id }, `${clock(f.started_utc)} ${f.site}`)));
  by("qt-flight").value = flights.some((f) => f.id === wanted) ? wanted : "";
  by("qt-flights").replaceChildren(...flights.map(flightRow));
  if (!flights.length) by("qt-flights").append(element("tr", {}, element("td", { colspan: "7" }, "none on this day")));
  by("qt-events").replaceChildren(...events.slice(-500).reverse().map(eventRow));
  if (!events.length) by("qt-events").append(element("tr", {}, element("td", { colspan: "6" }, "none")));
  for (const link of document.querySelectorAll("[data-form]")) {
    if (flights.length) link.href = `/api/v1/flights/export?form=${link.dataset.form}&show=${by("qt-show").value}&${query()}`;
    else link.removeAttribute("href");
    link.setAttribute("aria-disabled", `${!flights.length}`);
  }
  draw();
  by("qt-flights").setAttribute("aria-busy", "false");
}

const changes = (list) => list.filter((row, i) => i && row.status !== list[i - 1].status && row.approach === list[i - 1].approach)
  .map((row) => ({ ...row, event: NAMES[row.status] }));

// A flight that never said its end goes on while answers come, else it was cut off.
function ended(f) {
  if (!f.last_utc) return "no answer yet";
  if (f.is_finished) return clock(f.last_utc);
  return Date.now() - new Date(f.last_utc) < 60_000 ? "goes on" : `${clock(f.last_utc)} (cut off)`;
}

function flightRow(f) {
  const row = element("tr", { "data-flight": f.id, "aria-selected": `${by("qt-flight").value === f.id}` },
    ...[clock(f.started_utc), ended(f), f.site, f.source, f.preset, `${f.answers}`, `${f.events}`].map((c) => element("td", {}, c)));
  row.addEventListener("click", () => {
    by("qt-flight").value = by("qt-flight").value === f.id ? "" : f.id;
    refresh();
  });
  return row;
}

function eventRow(e) {
  const to = replay(e), link = to ? element("a", { href: to }, "open") : "";
  return element("tr", {}, ...[clock(e.utc), e.approach, (e.event ?? "").replaceAll("_", " "), e.station_m === null ? "" : distance(e.station_m),
    e.length_m === null ? "" : distance(e.length_m)].map((c) => element("td", {}, c)), element("td", {}, link));
}

// The chart: the station upwards, a strip of the status below.
function shape() {
  const times = rows.map((r) => +new Date(r.utc));
  const begin = Math.min(...times), end = Math.max(...times, begin + 10_000);
  const stations = rows.filter((r) => r.station_m !== null).map((r) => r.station_m);
  const low = Math.min(...stations, Infinity), high = Math.max(...stations, -Infinity);
  const room = Math.max((high - low) * 0.1, 5);
  const left = 62, right = canvas.clientWidth - 12, top = 12, bottom = canvas.clientHeight - 44;
  return { begin, end, left, right, top, bottom, low: low - room, high: high + room,
    x: (t) => left + ((t - begin) / (end - begin)) * (right - left),
    y: (s) => bottom - ((s - low + room) / (high - low + 2 * room)) * (bottom - top) };
}

function draw() {
  const ratio = devicePixelRatio || 1, c = canvas.getContext("2d"), look = getComputedStyle(document.documentElement);
  const colour = (name) => look.getPropertyValue(name).trim();
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = canvas.clientHeight * ratio;
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.font = "12px system-ui, sans-serif";
  c.fillStyle = colour("--dim");
  if (!rows.length) {
    c.fillText("Nothing is known of this day", 16, 40);
    return;
  }
  const at = shape();
  if (Number.isFinite(at.low)) grid(c, at, colour);
  const ticks = Math.max(Math.floor((at.right - at.left) / 110), 1);
  c.textAlign = "center";
  for (let i = 0; i <= ticks; i++) {
    const t = at.begin + ((at.end - at.begin) * i) / ticks;
    c.fillText(clock(t), Math.min(Math.max(at.x(t), at.left + 20), at.right - 26), canvas.clientHeight - 6);
  }
  c.textAlign = "left";
  const step_ms = (at.end - at.begin) / rows.length;
  rows.forEach((row, i) => {
    const next = rows.slice(i + 1).find((r) => r.approach === row.approach && r.flight === row.flight);
    const since = +new Date(row.utc), x = at.x(since);
    const to = at.x(Math.min(next ? +new Date(next.utc) : since, since + Math.max(4 * step_ms, 3000)));
    c.fillStyle = colour(COLOURS[row.status]);
    const [down, thick] = STRIP[row.status]; // also told by its height, for the colour-blind
    c.fillRect(x, at.bottom + 8 + down, Math.max(to - x, 1.5), thick);
    if (row.station_m === null) return;
    c.beginPath();
    c.arc(x, at.y(row.station_m), 2.6, 0, 7);
    c.fill();
  });
}

function grid(c, at, colour) {
  const unit_m = units() === "us" ? M_PER_FT : 1;
  const steps = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000].map((s) => s * unit_m);
  const step = steps.find((s) => (at.high - at.low) / s <= 6) ?? 50_000;
  c.strokeStyle = colour("--line");
  for (let s = Math.ceil(at.low / step) * step; s <= at.high; s += step) {
    c.beginPath();
    c.moveTo(at.left, at.y(s));
    c.lineTo(at.right, at.y(s));
    c.stroke();
    c.textAlign = "right";
    c.fillText(distance(s), at.left - 6, at.y(s) + 4);
  }
}

function nearest(event) {
  if (!rows.length) return null;
  const at = shape(), x = event.clientX - canvas.getBoundingClientRect().left;
  return rows.reduce((best, row) => (Math.abs(at.x(+new Date(row.utc)) - x) < Math.abs(at.x(+new Date(best.utc)) - x) ? row : best));
}
canvas.addEventListener("mousemove", (event) => {
  const row = nearest(event);
  if (!row) return;
  const eoq = row.station_m === null ? "" : `: ${row.sigma_m === null ? distance(row.station_m) : plusMinus(row.station_m, row.sigma_m)}`;
  by("qt-dayread").textContent = `${clock(row.utc)} ${row.approach} ${NAMES[row.status]}${eoq}${replay(row) ? " (click to open)" : ""}`;
});
canvas.addEventListener("click", (event) => {
  const row = nearest(event), to = row && replay(row);
  if (to) location.href = to;
  else if (row) say("Replay it with queuetail open and the folder of its run, or queuetail replay and its recording.");
});

const shift = (days) => {
  const [begin] = span();
  begin.setDate(begin.getDate() + days);
  by("qt-date").value = dayOf(begin);
  refresh();
};
by("qt-before").addEventListener("click", () => shift(-1));
by("qt-after").addEventListener("click", () => shift(1));
for (const id of ["qt-date", "qt-flight", "qt-show"]) by(id).addEventListener("change", refresh);
document.addEventListener("qt-theme", draw);
new ResizeObserver(draw).observe(canvas);

await ownRun().catch(() => {});
let first = run ? new Date(run.begin) : new Date();
if (about.live) first = new Date();
by("qt-date").value = dayOf(first);
await refresh();
if (about.live) setInterval(() => { if (!document.hidden) refresh(); }, 15_000);
