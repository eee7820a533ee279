// The Accuracy check screen: points with their true places, the errors, and what mends them.
import { Board, get, lanesOf, place, save } from "./board.js";
import { appeared, distance, element, fixed, speed } from "./format.js";
import { MapView } from "./map.js";

const about = JSON.parse((await appeared("qt-check")).dataset.about);
const by = (id) => document.getElementById(id);
const said = by("qt-said"), entry = by("qt-entry"), where = by("qt-where");
const points = [];
let pending = null, errors = null, tracksNow = [];

const board = new Board(by("qt-still"), "Picture: click a point whose true place you know", (px) => {
  pending = { number: board.still.number, t_s: board.still.t_s, px };
  entry.hidden = false;
  by("qt-asked").dataset.time = board.still.t_s;
  by("qt-asked").textContent = `What is the true place of ${px.map((v) => v.toFixed(0)).join(", ")}?`;
  where.value = "";
  where.focus({ preventScroll: true });
  draw();
});
const moment = by("qt-moment");
const player = about.live ? null : { get t_s() { return Number(moment.value); } };
const map = new MapView(player);

const say = (words, bad = false) => {
  said.textContent = words;
  said.classList.toggle("qt-warning", bad && words !== "");
};
const query = () => points.map((p) => [p.number, ...p.px.map((v) => v.toFixed(2)), ...p.at.map((v) => v.toFixed(8))].join(",")).join(";");

async function hold(kept = "") {
  try {
    const still = await board.hold(player?.t_s);
    say(still.is_placed ? kept : `Pixels cannot be placed now: ${still.reasons.join("; ")}`, true);
    if (moment) by("qt-clock").textContent = `${still.t_s.toFixed(1)} s`;
    const { tracks } = await get(`/api/v1/tracks${player ? `?t_s=${player.t_s}` : ""}`);
    const chosen = by("qt-vehicle").value;
    by("qt-vehicle").replaceChildren(...tracks.filter((t) => t.speed_mps !== null).map((t) =>
      element("option", { value: t.track_id }, `${t.track_id}: ${speed(t.speed_mps)} now`)));
    if (chosen) by("qt-vehicle").value = chosen;
    tracksNow = tracks;
  } catch (error) {
    say(error.message, true);
  }
  draw();
}

function draw() {
  const mine = points.filter((p) => p.number === board.still?.number);
  board.draw([...lanesOf(board.still),
    ...(by("qt-speed").open ? tracksNow.filter((t) => t.u_px !== null).map((t) => ({ point: [t.u_px, t.v_px], kind: "vehicle", text: `${t.track_id}` })) : []),
    ...mine.map((p) => ({ point: p.px, kind: "known", text: `${points.indexOf(p) + 1}` })),
    ...(pending && pending.number === board.still?.number ? [{ point: pending.px, kind: "pending", text: "?" }] : [])]);
}

const far = (value) => distance(value, 2);

function table() {
  by("qt-points").replaceChildren(...points.map((p, i) => {
    const e = errors?.points[i];
    const remove = element("button", { type: "button", class: "qt-small", "aria-label": `Remove point ${i + 1}` }, "✕");
    remove.addEventListener("click", () => { points.splice(i, 1); measure(); });
    const cells = [`${i + 1}`, `${p.t_s.toFixed(1)}`, p.at.map((v) => v.toFixed(7)).join(", "),
      e?.measured_lat_deg === null ? "at or above the horizon" : e ? `${e.measured_lat_deg.toFixed(7)}, ${e.measured_lon_deg.toFixed(7)}` : "",
      far(e?.error_m), signed(e?.beyond_m), signed(e?.right_m)];
    return element("tr", {}, ...cells.map((c) => element("td", {}, c)), element("td", {}, remove));
  }));
  by("qt-nopoints").hidden = points.length > 0;
  by("qt-mean").textContent = far(errors?.mean_m);
  by("qt-worst").textContent = far(errors?.worst_m);
  by("qt-improve").disabled = !points.length || !board.still?.has_pose;
  by("qt-csv").disabled = !points.length;
}
const signed = (value) => (value > 0 ? "+" : "") + far(value);

async function measure() {
  by("qt-found").replaceChildren();
  try {
    errors = points.length ? await get(`/api/v1/check?points=${query()}`) : null;
    say("");
  } catch (error) {
    errors = null;
    say(error.message, true);
  }
  table();
  draw();
  arrows();
}

// On the map: from the true place, a ring, to the measured one, a dot.
function arrows() {
  if (!map.L) return;
  map.errors ??= map.L.layerGroup().addTo(map.map);
  map.errors.clearLayers();
  points.forEach((p, i) => {
    const e = errors?.points[i];
    map.L.circleMarker(p.at, { radius: 6, color: "#fff", weight: 3, fillColor: "#0a7", fillOpacity: 1 })
      .bindTooltip(`${i + 1}`, { permanent: true, direction: "right", className: "qt-tip" }).addTo(map.errors);
    if (e?.measured_lat_deg === null || !e) return;
    const to = [e.measured_lat_deg, e.measured_lon_deg];
    map.L.polyline([p.at, to], { color: "#fff", weight: 6 }).addTo(map.errors);
    map.L.polyline([p.at, to], { color: "#d4002a", weight: 3 }).addTo(map.errors);
    map.L.circleMarker(to, { radius: 4, stroke: false, fillColor: "#d4002a", fillOpacity: 1 }).addTo(map.errors);
  });
}

entry.addEventListener("submit", (event) => {
  event.preventDefault();
  const at = place(where.value);
  if (!at) return say("Write latitude and longitude as 36.11306, -97.05883", true);
  points.push({ ...pending, at });
  pending = null;
  entry.hidden = true;
  measure();
});
by("qt-cancel").addEventListener("click", () => { pending = null; entry.hidden = true; draw(); });

by("qt-improve").addEventListener("click", async () => {
  by("qt-improve").disabled = true;
  say("Looking for the offsets …");
  try {
    show(await get(`/api/v1/check/improvement?points=${query()}`));
    say("");
  } catch (error) {
    say(error.message, true);
  }
  by("qt-improve").disabled = false;
});

function show(found) {
  const rows = [["Heading", found.heading_deg, "°"], ["Pitch", found.pitch_deg, "°"], ["Height", found.height_m, ""]].map(([name, o, unit]) =>
    element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, o.is_determined
      ? (unit ? `${o.value > 0 ? "+" : ""}${fixed(o.value, 2)}${unit} ± ${fixed(o.sigma, 2)}${unit}` : `${signed(o.value)} ± ${far(o.sigma)}`) : "not determined by these points")));
  const head = element("tr", {}, ...["By telemetry alone", "before", "after"].map((t) => element("th", { scope: "col" }, t)));
  const compare = [["mean error", "mean_m"], ["worst error", "worst_m"]].map(([name, key]) =>
    element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, far(found.before[key])), element("td", {}, far(found.after[key]))));
  if (found.held_out_m !== null) compare.push(element("tr", {}, element("th", { scope: "row" }, "each by the others' offsets"), element("td", {}, ""), element("td", {}, far(found.held_out_m))));
  const notes = found.misfits.map((i) => `Point ${i + 1} does not fit the others: look whether its place is right.`);
  if ([found.heading_deg, found.pitch_deg, found.height_m].some((o) => !o.is_determined)) notes.push("Add points near and far, left and right, to determine the rest.");
  if (!found.helps) notes.push("These offsets do not make the points better: there is nothing to apply.");
  by("qt-found").replaceChildren(element("table", {}, ...rows),
    element("table", { class: "qt-compare" }, element("thead", {}, head), element("tbody", {}, ...compare)),
    ...notes.map((n) => element("p", { class: "qt-warning" }, n)),
    ...(found.helps ? [consent()] : []));
}

// Nothing is applied but by an operator, and only after the box is ticked.
function consent() {
  if (about.role !== "operator") return element("p", {}, "An operator can apply these offsets.");
  const box = element("input", { type: "checkbox", id: "qt-consent" });
  const kept = element("input", { type: "checkbox", id: "qt-keep" });
  const button = element("button", { type: "button", class: "qt-button", id: "qt-apply", disabled: "" }, "Apply");
  box.addEventListener("change", () => { button.disabled = !box.checked; });
  button.addEventListener("click", async () => {
    button.disabled = true;
    try {
      const used = await save("/api/v1/check/apply", { points: query() }, kept.checked ? by("qt-file").value : null);
      points.length = 0;
      errors = null;
      table();
      by("qt-found").replaceChildren();
      const words = `${used.in_use ? "The run goes on with these offsets" : "A finished run stays as it is"}${used.file ? `; ${used.file} has them` : ""}. Click points again to see how far off they are now.`;
      say(words);
      arrows();
      setTimeout(() => hold(words), about.live ? 1500 : 0);
    } catch (error) {
      say(error.message, true);
      button.disabled = false;
    }
  });
  const words = about.live ? "The run may begin anew with these offsets" : "These are the right offsets";
  return element("div", { class: "qt-consent" }, element("label", {}, box, ` ${words}`),
    element("label", {}, kept, " keep them in ", element("input", { id: "qt-file", value: about.file, "aria-label": "Site file", size: "18" })), button);
}

by("qt-csv").addEventListener("click", () => {
  const rows = points.map((p) => [p.t_s.toFixed(3), ...p.px.map((v) => v.toFixed(2)), ...p.at.map((v) => v.toFixed(8))].join(","));
  const url = URL.createObjectURL(new Blob([`${["t_s,u_px,v_px,lat,lon", ...rows].join("\n")}\n`], { type: "text/csv" }));
  element("a", { href: url, download: "points.csv" }).click();
  URL.revokeObjectURL(url);
});

by("qt-compare-speed").addEventListener("click", async () => {
  const out = by("qt-speeds");
  try {
    const now_s = board.still?.t_s ?? 0;
    const s = await get(`/api/v1/check/speed?track_id=${by("qt-vehicle").value}&true_mph=${by("qt-mph").value}&since_s=${Math.max(now_s - 30, 0)}&until_s=${now_s + 30}`);
    out.textContent = `Measured ${fixed(s.measured_mph, 1)} ± ${fixed(s.spread_mph, 1)} mph over ${fixed(s.duration_s, 0)} s, true ${fixed(s.true_mph, 1)} mph: ${fixed(s.measured_mph - s.true_mph, 1)} mph off. Multiply by ${fixed(s.factor, 3)} to correct.`;
  } catch (error) {
    out.textContent = error.message;
  }
});
by("qt-speed").addEventListener("toggle", draw);
by("qt-hold").addEventListener("click", () => hold());
moment?.addEventListener("change", () => hold());

table();
await map.start();
map.map.on("click", (event) => {
  if (!pending) return say("Click a point in the picture first, then its true place on the map.");
  where.value = `${event.latlng.lat.toFixed(7)}, ${event.latlng.lng.toFixed(7)}`;
});
async function begin() {
  await hold();
  if (!board.still) setTimeout(begin, 1000);
}
begin();
