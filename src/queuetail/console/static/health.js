// The Health screen: asks once a second, and says so when nobody answers.
import { appeared, ask, duration, element, fixed } from "./format.js";

const LATE_S = 2.0;
const place = await appeared("qt-health");
let heard_s = performance.now() / 1000;

const card = (title, rows) =>
  element("section", { class: "qt-card" }, element("h2", {}, title),
    element("table", {}, ...rows.map(([name, value]) =>
      element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, value)))));

const words = (name) => name.replaceAll("_", " ");

function telemetry(health) {
  const names = Object.keys(health.telemetry_age_s);
  if (!names.length) return [[health.live ? "none but the recording's own log" : "of a finished run: none", ""]];
  return names.map((name) => [words(name),
    `${duration(health.telemetry_age_s[name])} old, ${fixed(health.telemetry_rate_hz[name], 1, "Hz")}`]);
}

function outlets(health) {
  const head = ["", "state", "delivered", "waiting", "dropped", "last delivery", "last error"];
  const rows = health.outlets.map((o) => [o.name, o.state, o.delivered, o.waiting, o.dropped,
    o.delivery_age_s === null ? "–" : `${duration(o.delivery_age_s)} ago`, o.last_error || "none"]);
  return element("section", { class: "qt-card qt-wide" }, element("h2", {}, "Recording, files, feeds and signs"),
    element("div", { class: "qt-scroll", tabindex: "0" }, element("table", { class: "qt-table" },
      element("thead", {}, element("tr", {}, ...head.map((t) => element(t ? "th" : "td", t ? { scope: "col" } : {}, t)))),
      element("tbody", {}, ...rows.map(([name, ...rest]) =>
        element("tr", {}, element("th", { scope: "row" }, name), ...rest.map((v) => element("td", {}, `${v}`))))))));
}

function show(health) {
  const said = [...new Set([...health.problems, ...health.warnings])];
  const seen = health.frames_captured;
  const lost = seen ? ` (${fixed(100 * health.frames_dropped / seen, 1)} %)` : "";
  place.replaceChildren(
    element("div", { class: "qt-wide", role: "status" },
      ...(said.length ? said.map((s) => element("p", { class: "qt-warning" }, `⚠ ${s}`))
        : [element("p", { class: "qt-well" }, health.live ? "✓ Answers are made and delivered" : "✓ A finished run")])),
    card("Pictures", [
      ["age of the newest", duration(health.frame_age_s)],
      ["processed per second", fixed(health.frame_rate_hz, 1)],
      ["captured", `${seen}`], ["processed", `${health.frames_processed}`],
      ["left out for newer ones", `${health.frames_dropped}${lost}`],
      ["connected again", `${health.reconnects} times`],
      ["registration", fixed(health.registration === null ? null : 100 * health.registration, 0, "%")]]),
    card("From picture to answer", [
      ["median", fixed(health.latency_p50_ms, 0, "ms")], ["99 %", fixed(health.latency_p99_ms, 0, "ms")]]),
    card("Telemetry", telemetry(health)),
    card("This machine", [
      ["memory used", fixed(health.memory_mb, 0, "MB")],
      ["free on the disk", fixed(health.disk_free_mb === null ? null : health.disk_free_mb / 1000, 1, "GB")],
      ["video", health.video], ["method", health.preset]]),
    ...(health.outlets.length ? [outlets(health)] : []));
}

async function refresh() {
  try {
    show(await ask("/api/v1/health"));
    heard_s = performance.now() / 1000;
    document.getElementById("qt-silent")?.remove();
  } catch {
    const silent_s = performance.now() / 1000 - heard_s;
    if (silent_s > LATE_S && !document.getElementById("qt-silent")) {
      place.prepend(element("p", { id: "qt-silent", class: "qt-warning qt-wide", role: "alert" },
        "⚠ queuetail does not answer: what is shown below is old."));
    }
  }
  setTimeout(refresh, 1000);
}
refresh();
