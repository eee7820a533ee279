// The Set up screen: check what comes in, accept or draw the road, place signs, use and keep it.
import { Board, get, lanesOf, save, send } from "./board.js";
import { appeared, distance, duration, element, fixed } from "./format.js";

const about = JSON.parse((await appeared("qt-setup")).dataset.about);
const by = (id) => document.getElementById(id);
const moment = by("qt-moment");
const draft = { roads: [], signs: [] };
let known = null, mode = null, axis = [], chosen = 0;

const board = new Board(by("qt-still"), "Picture: click the road's axis or a sign", clicked);
const say = (words, bad = false) => {
  by("qt-said").textContent = words;
  by("qt-said").classList.toggle("qt-warning", bad && words !== "");
};

async function hold() {
  try {
    const still = await board.hold(moment ? Number(moment.value) : undefined);
    if (moment) by("qt-clock").textContent = `${still.t_s.toFixed(1)} s`;
    say(still.is_placed ? "" : `The picture's place is not known: ${still.reasons.join("; ")}`, true);
    axis = [];
    await load();
  } catch (error) {
    say(error.message, true);
  }
  draw();
}

// 1. What comes in.
const NEEDED = ["position", "height", "heading", "gimbal_pitch", "hfov"];
const quantity = (name) => (name === "hfov" ? "field of view" : name.replaceAll("_", " "));
const told = (value) => (/ m$/.test(value) ? distance(parseFloat(value)) : value.replaceAll("-", "−"));
async function checks() {
  try {
    const health = await get("/api/v1/health");
    const good = (is, words) => element("li", { class: is ? "qt-good" : "qt-bad" }, words);
    const still = board.still, live = about.live;
    by("qt-checks").replaceChildren(
      good(still && (!live || health.frame_age_s < 2), still
        ? `Video ${health.video}: ${still.width}×${still.height}${live ? `, ${fixed(health.frame_rate_hz, 0)} answers a second, newest ${duration(health.frame_age_s)} old` : ""}`
        : live ? `No picture from ${health.video} yet` : "No picture: open the run with --video"),
      good(still?.is_placed, still?.is_placed ? `The picture's place is known${still.has_pose ? " by telemetry" : " by control points"}`
        : `The picture's place is not known${still ? `: ${still.reasons.join("; ")}` : ""}`),
      ...health.warnings.map((w) => good(false, w)));
    const { telemetry } = await get("/api/v1/setup");
    const names = [...new Set([...NEEDED, ...Object.keys(telemetry), ...Object.keys(health.telemetry_age_s)])];
    const placed = still?.is_placed && !still.has_pose;
    by("qt-quantities").replaceChildren(...names.filter((n) => !placed || telemetry[n]).map((n) => element("tr", {},
      element("th", { scope: "row" }, quantity(n)), element("td", {}, n in telemetry ? told(telemetry[n]) : "missing"),
      element("td", {}, n in health.telemetry_age_s ? duration(health.telemetry_age_s[n]) : telemetry[n] ? "from a log" : ""),
      element("td", {}, n in health.telemetry_rate_hz ? fixed(health.telemetry_rate_hz[n], 1, "Hz") : ""))));
  } catch { /* the next round says it */ }
  setTimeout(checks, 1000);
}

// 2. The road.
async function load() {
  known = await get("/api/v1/setup");
  if (!draft.loaded) {
    draft.loaded = true;
    by("qt-name").value = known.draft.name;
    by("qt-file").value = known.file ?? "site.toml";
    by("qt-posted").value = known.draft.posted_speed_mph ?? "";
    by("qt-queue").value = known.draft.queue_speed_mph ?? "";
    draft.roads = known.draft.roads;
    draft.signs = known.draft.signs;
    choose(0);
  }
  const found = known.roads.filter((r) => r.is_found);
  by("qt-accept").disabled = !found.length;
  by("qt-roadnote").textContent = found.length ? `Found in the traffic: ${found.map((r) => `${r.name}, ${r.lanes} ${r.lanes === 1 ? "lane" : "lanes"}, ${distance(r.length_m)}`).join("; ")}.`
    : draft.roads.length ? "The road is known. Draw it anew if its lines do not lie on the road." : "No road is known yet: wait for traffic, or draw it.";
  preview();
}

function choose(index) {
  chosen = index;
  const road = draft.roads[index];
  if (road) {
    by("qt-road").value = road.name;
    by("qt-lanes").value = road.lanes;
    by("qt-width").value = road.lane_width_m;
  }
  by("qt-turn").disabled = !road && axis.length < 2;
  by("qt-roads").replaceChildren(...(draft.roads.length > 1 ? draft.roads.map((r, i) => {
    const button = element("button", { type: "button", class: "qt-button qt-quiet", "aria-pressed": `${i === index}` }, r.name);
    button.addEventListener("click", () => { choose(i); draw(); });
    return button;
  }) : []));
}

by("qt-accept").addEventListener("click", () => {
  draft.roads = known.roads.map(({ length_m, is_found, ...road }) => road);
  choose(0);
  enter(null);
  preview();
  say("Taken. The arrow shows the direction of travel; turn it around if that is wrong.");
});
by("qt-draw").addEventListener("click", () => {
  axis = [];
  enter(mode === "axis" ? null : "axis");
  if (mode) say("Click along the left edge of the left lane, in the direction of travel, from one edge of the picture to the other. Then fill in the lanes.");
});
by("qt-undo").addEventListener("click", () => { axis.pop(); placeAxis(); });
by("qt-turn").addEventListener("click", () => {
  const road = draft.roads[chosen];
  if (axis.length > 1) axis.reverse();
  if (road) turn(road);
  draw();
  preview();
  if (axis.length > 1) placeAxis();
});

// The other way round the left edge is the other edge: the axis moves across all lanes.
function turn(road) {
  const [lat0, lon0] = road.axis[0], k = Math.cos((lat0 * Math.PI) / 180) * 111320, m = 111320;
  const width = axis.length > 1 ? 0 : road.lanes * road.lane_width_m;
  const points = road.axis.map(([lat, lon]) => [(lon - lon0) * k, (lat - lat0) * m]);
  const moved = points.map(([x, y], i) => {
    const [a, b] = points[Math.max(i - 1, 0)], [c, d] = points[Math.min(i + 1, points.length - 1)];
    const length = Math.hypot(c - a, d - b) || 1;
    return [x + ((d - b) / length) * width, y - ((c - a) / length) * width];
  });
  road.axis = moved.reverse().map(([x, y]) => [Number((lat0 + y / m).toFixed(8)), Number((lon0 + x / k).toFixed(8))]);
  road.start_station_m = 0;
}

function enter(next) {
  mode = next;
  by("qt-draw").setAttribute("aria-pressed", `${mode === "axis"}`);
  by("qt-sign").setAttribute("aria-pressed", `${mode === "sign"}`);
  by("qt-undo").disabled = mode !== "axis";
  if (!mode) axis = [];
  draw();
}

const places = (px) => get(`/api/v1/still/${board.still.number}/places?px=${px.map((p) => p.map((v) => v.toFixed(2)).join(",")).join(";")}`);

async function clicked(px) {
  if (mode === "axis") {
    axis.push(px);
    await placeAxis();
  } else if (mode === "sign") {
    const [spot] = await places([px]);
    if (spot.lat_deg === null) return say("That pixel looks at or above the horizon.", true);
    const name = by("qt-signname").value.trim() || `sign ${draft.signs.length + 1}`;
    draft.signs = [...draft.signs.filter((s) => s.name !== name), { name, at: [spot.lat_deg, spot.lon_deg], approach: draft.roads.length > 1 ? draft.roads[chosen].name : null }];
    by("qt-signname").value = `sign ${draft.signs.length + 1}`;
    enter(null);
    say(`${name} is placed.`);
    preview();
  } else say("Choose “Draw it” or a sign first, then click.");
}

async function placeAxis() {
  draw();
  by("qt-turn").disabled = axis.length < 2;
  if (axis.length < 2) return;
  try {
    const spots = await places(axis);
    if (spots.some((s) => s.lat_deg === null)) return say("A point of the road looks at or above the horizon: undo it.", true);
    const road = { name: by("qt-road").value || "road", lanes: Number(by("qt-lanes").value), lane_width_m: Number(by("qt-width").value), start_station_m: 0, axis: spots.map((s) => [s.lat_deg, s.lon_deg]) };
    if (draft.roads.length) draft.roads[chosen] = road; else draft.roads = [road];
    choose(chosen);
    await preview();
  } catch (error) {
    say(error.message, true);
  }
}

for (const id of ["qt-road", "qt-lanes", "qt-width", "qt-posted", "qt-queue", "qt-name"]) {
  by(id).addEventListener("change", () => {
    const road = draft.roads[chosen];
    if (road) Object.assign(road, { name: by("qt-road").value || "road", lanes: Number(by("qt-lanes").value), lane_width_m: Number(by("qt-width").value) });
    preview();
  });
}

// 3. Signs.
by("qt-sign").addEventListener("click", () => {
  enter(mode === "sign" ? null : "sign");
  if (mode) say("Click where the sign stands in the picture.");
});

// 4. Use and keep.
const number = (id) => (by(id).value === "" ? null : Number(by(id).value));
const body = () => ({ name: by("qt-name").value || "unnamed site", posted_speed_mph: number("qt-posted"), queue_speed_mph: number("qt-queue"), roads: draft.roads, signs: draft.signs });

async function preview() {
  by("qt-signs").replaceChildren(...draft.signs.map((s) => {
    const remove = element("button", { type: "button", class: "qt-small", "aria-label": `Remove ${s.name}` }, "✕");
    remove.addEventListener("click", () => { draft.signs = draft.signs.filter((o) => o !== s); preview(); });
    return element("li", {}, `${s.name}: ${s.at ? s.at.map((v) => v.toFixed(6)).join(", ") : "by its station"} `, remove);
  }));
  draw();
  try {
    const { toml, queue_speed_mph } = await send("/api/v1/setup/preview", body());
    by("qt-toml").textContent = toml;
    by("qt-queue").placeholder = fixed(queue_speed_mph, 1);
    by("qt-save").disabled = false;
  } catch (error) {
    by("qt-save").disabled = true;
    say(error.message, true);
  }
}

by("qt-save").addEventListener("click", async () => {
  by("qt-save").disabled = true;
  try {
    const used = await save("/api/v1/setup/save", { draft: body() }, by("qt-file").value || null);
    say(`${used.in_use ? "The run goes on with it" : "Saved"}${used.file ? `; kept in ${used.file}` : ""}. Look at Watch.`);
    enter(null);
    setTimeout(async () => { const words = by("qt-said").textContent; await hold(); say(words); }, 1500);
  } catch (error) {
    say(error.message, true);
  }
  by("qt-save").disabled = false;
});

// The drawn roads as lines in the held picture: places go back to pixels through what was clicked,
// or through the lanes that the method draws.
let shown = [];
async function roadsInPicture() {
  if (!board.still?.is_placed || !draft.roads.length) { shown = []; return; }
  const key = JSON.stringify([board.still.number, draft.roads.map((r) => r.axis)]);
  if (roadsInPicture.key === key) return;
  roadsInPicture.key = key;
  try {
    const found = await send(`/api/v1/setup/pixels`, { number: board.still.number, lines: draft.roads.map((r) => r.axis), points: draft.signs.filter((s) => s.at).map((s) => s.at) });
    shown = found.lines;
  } catch { shown = []; }
  paint();
}
let signsKey = "", signsPx = [];
async function signsInPicture() {
  const key = JSON.stringify([board.still?.number, draft.signs]);
  if (!board.still?.is_placed || key === signsKey) return;
  signsKey = key;
  try {
    signsPx = (await send(`/api/v1/setup/pixels`, { number: board.still.number, lines: [], points: draft.signs.filter((s) => s.at).map((s) => s.at) })).points;
  } catch { signsPx = []; }
  paint();
}

function draw() {
  paint();
  roadsInPicture();
  signsInPicture();
}

function paint() {
  const placed = draft.signs.filter((s) => s.at);
  board.draw([...(draft.roads.length ? [] : lanesOf(board.still)),
    ...(axis.length ? [] : shown.flatMap((lines, i) => lines.map((line) => ({ line, kind: i === chosen ? "axis" : "other", arrows: true })))),
    ...(axis.length > 1 ? [{ line: axis, kind: "axis", arrows: true }] : []),
    ...axis.map((point) => ({ point, kind: "axis" })),
    ...signsPx.flatMap((point, i) => (point && placed[i] ? [{ point, kind: "sign", text: placed[i].name }] : []))]);
}

by("qt-hold").addEventListener("click", () => hold());
moment?.addEventListener("change", () => hold());
async function begin() {
  await hold();
  if (!board.still) return setTimeout(begin, 1000);
  // While no road is known, look again for one that the traffic shows.
  setInterval(async () => { if (!draft.roads.length && !axis.length && about.live) await load().catch(() => {}); }, 2000);
}
begin();
checks();
if (about.paper) import("./sliders.js");
